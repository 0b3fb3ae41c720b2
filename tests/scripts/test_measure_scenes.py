"""The script that measures labels along a sequence, on one of a few frames."""

import runpy

from conftest import ROOT

from slam_bof.core import registry
from slam_bof.slam import config


def test_a_row_has_all_its_columns(write_turn, tmp_path):
    script = runpy.run_path(str(ROOT / "scripts" / "measure_scenes"))
    folder = tmp_path / "room" / "seq-01"
    write_turn(folder, [0.0, 0.1, 0.2, 0.3])
    (folder / "scenes.csv").write_text("frame,scene\n" + "".join(f"{k},bath\n" for k in range(4)))
    chosen = config.override(
        config.preset("indoor"), ["keyframes.policy=every", "keyframes.every=1"]
    )
    row = script["measure"](registry.open_dataset(folder), chosen)
    named = dict(zip(script["COLUMNS"], [0.2, *row], strict=True))
    assert len(row) + 1 == len(script["COLUMNS"])
    assert named["keyf"] == 4
    assert named["rooms"] >= 1
    assert named["raw"] == 0.0, "no class of the model is called so"
    assert named["loops"] == 0
