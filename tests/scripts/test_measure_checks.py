"""The script that measures what checks of input cost."""

import argparse
import json
import time


def test_the_time_of_slow_checks_is_counted(load_script, write_turn, tmp_path, capsys, monkeypatch):
    script = load_script("measure_checks")
    find_fault = script["map_reader"].find_fault

    def slow(table, row):
        until_s = time.process_time() + 0.01
        while time.process_time() < until_s:
            pass
        return find_fault(table, row)

    monkeypatch.setattr(script["map_reader"], "find_fault", slow)
    write_turn(tmp_path / "room" / "seq-01", [0.0, 0.6])
    options = {"config": "indoor", "assignments": [], "max_frames": None, "repeats": 1}
    script["measure"](
        argparse.Namespace(
            sequence=tmp_path / "room" / "seq-01", json=True, markdown=False, **options
        )
    )
    rows = {row["what"]: row for row in map(json.loads, capsys.readouterr().out.splitlines())}
    query = rows["query keyframes"]
    assert query["checks_ms"] > 30.0, "two keyframes and a session"
    assert query["share"] > 0.5
    assert all(row["checks_ms"] > 0.0 for row in rows.values())


def test_a_check_within_another_counts_once(load_script):
    script = load_script("measure_checks")
    watch = script["Stopwatch"]()

    def spin():
        until_s = time.process_time() + 0.02
        while time.process_time() < until_s:
            pass

    inner = watch.around(spin)
    watch.around(lambda: (inner(), inner()))()
    assert 0.04 <= watch.s < 0.06
