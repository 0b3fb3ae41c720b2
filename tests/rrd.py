"""What a file of rerun holds."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest


def read_rrd(file: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of each entity, in the order of writing, by the names of their columns."""
    chunk = pytest.importorskip("rerun.chunk", reason="needs rerun: pip install slam-bof[view]")
    rows = defaultdict(list)
    for part in chunk.RrdReader(str(file)).stream().to_chunks():
        batch = part.to_record_batch()
        names = [name for name in batch.schema.names if name != "log_time"]
        rows[part.entity_path] += batch.select(names).to_pylist()
    return dict(rows)
