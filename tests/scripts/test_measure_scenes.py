"""The script that measures labels along a sequence, on one of a few frames."""

from slam_bof.core import registry
from slam_bof.slam import config


def test_a_row_has_all_its_columns(load_script, write_turn, tmp_path):
    script = load_script("measure_scenes")
    folder = tmp_path / "room" / "seq-01"
    write_turn(folder, [0.0, 0.1, 0.2, 0.3])
    (folder / "scenes.csv").write_text("frame,scene\n" + "".join(f"{k},bath\n" for k in range(4)))
    chosen = config.override(
        config.preset("indoor"), ["keyframes.policy=every", "keyframes.every=1"]
    )
    row = script["measure_run"](registry.open_dataset(folder), chosen)
    assert set(row) == set(script["COLUMNS"]) - {"sequence", "check"}
    assert row["n_keyframes"] == 4
    assert row["n_rooms"] >= 1
    assert row["raw"] == 0.0, "no class of the model is called so"
    assert row["n_loops"] == 0
