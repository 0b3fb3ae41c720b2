"""Write the texts of variables in a MATLAB file as JSON: ``mat_strings.py FILE VARIABLE...``.

A program of its own, because SciPy's reader of such files may crash on a damaged one.
"""

from __future__ import annotations

import json
import sys

__all__ = ["main"]

MAX_BYTES = 4 << 30


def main(file: str, *names: str) -> None:
    """Write a JSON object of lists to stdout; of an error, the last line on stderr says why."""
    import numpy as np
    from scipy.io import loadmat

    found = loadmat(file, squeeze_me=True, variable_names=names)
    values = {name: np.atleast_1d(found[name]).tolist() for name in names}
    json.dump({name: [str(item)[:4096] for item in values[name]] for name in names}, sys.stdout)


if __name__ == "__main__":
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    except (ImportError, ValueError, OSError):  # other systems have no such limit
        pass
    main(*sys.argv[1:])
