"""What ``scripts/fuzz`` tries: files to mutate for each kind of reader, and checks of what is read.

A module has the readers of one kind of file: ``READERS``, by name.
"""

from fuzzing import (
    archives,
    atlases,
    bags,
    calls,
    configurations,
    images,
    maps,
    models,
    runs,
    sequences,
    servers,
    tables,
)
from fuzzing.cases import Reader, turn

__all__ = ["READERS", "Reader", "turn"]

MODULES = (
    *(maps, atlases, models, configurations, archives, servers),
    *(sequences, images, bags, tables, runs, calls),
)
READERS: dict[str, Reader] = {
    name: reader for module in MODULES for name, reader in module.READERS.items()
}
"""Every reader."""
