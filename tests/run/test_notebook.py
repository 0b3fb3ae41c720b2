"""The notebook of the documentation runs from the top, on a small sequence."""

import json

import numpy as np
from conftest import ROOT

NOTEBOOK = ROOT / "docs" / "notebooks" / "place.ipynb"


def test_the_notebook_runs(write_turn, tmp_path, monkeypatch, capsys):
    write_turn(tmp_path / "room" / "seq-01", np.linspace(0.0, 0.9, 10).tolist())
    monkeypatch.setenv("SLAM_BOF_SEQUENCE", str(tmp_path / "room" / "seq-01"))
    monkeypatch.setenv("SLAM_BOF_RUNS", str(tmp_path / "runs"))
    content = json.loads(NOTEBOOK.read_text("utf-8"))
    cells = ["".join(c["source"]) for c in content["cells"] if c["cell_type"] == "code"]
    assert sum(len(cell.splitlines()) for cell in cells) <= 30
    names: dict[str, object] = {}
    for cell in cells:
        exec(compile(cell, NOTEBOOK.name, "exec"), names)
    printed = capsys.readouterr().out
    assert "room/seq-01: 10 depth images" in printed
    assert "n_keyframes" in printed
    figure = names["figure"]
    assert figure.layout.images[0].source.startswith("data:image/png;base64,")
    assert len(figure.data[0].x) == len(names["T_map_camera"]) + 1 > 2
