"""Print the texts of variables in a MATLAB file as JSON: ``mat_strings.py FILE VARIABLE...``.

A program of its own, because SciPy's reader of such files may crash on a damaged one.
"""

from __future__ import annotations

import json
import sys

MAX_BYTES = 4 << 30


def main(file: str, *names: str) -> None:
    """Print a JSON object of lists; the last line on stderr says why it cannot."""
    import numpy as np
    from scipy.io import loadmat

    found = loadmat(file, squeeze_me=True, variable_names=names)
    values = {name: np.atleast_1d(found[name]).tolist() for name in names}
    print(json.dumps({name: [str(item)[:4096] for item in values[name]] for name in names}))


if __name__ == "__main__":
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_BYTES, MAX_BYTES))
    except (ImportError, ValueError, OSError):  # other systems have no such limit
        pass
    try:
        main(*sys.argv[1:])
    except Exception as error:  # whatever it is, the one who asked has a line to print
        sys.exit(f"{type(error).__name__} ({' '.join(str(error).split())})")
