"""Work on a Dask cluster instead of this machine (extra ``dask``)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import joblib

from slam_bof.errors import PluginError, RunError

__all__ = ["on_cluster"]

TIMEOUT_S = 10


@contextmanager
def on_cluster(scheduler: str) -> Iterator[None]:
    """Send what joblib runs inside the block to a Dask cluster.

    A task whose worker is killed runs again on another. The cluster's workers need the package of
    the same version, the data under the same paths, and one thread each.

    Parameters
    ----------
    scheduler
        Its address, such as ``tcp://10.0.0.1:8786``.

    Raises
    ------
    PluginError
        If Dask is not installed.
    RunError
        If there is no scheduler at that address.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise PluginError(
            "--scheduler: found no dask.distributed; pip install 'slam-bof[dask]'"
        ) from error
    try:
        client = Client(scheduler, timeout=TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise RunError(
            f"{scheduler}: found no scheduler of Dask, expected one like tcp://10.0.0.1:8786 "
            f"({' '.join(str(error).split())[:120]})"
        ) from error
    with client, joblib.parallel_config(backend="dask", n_jobs=-1):
        yield
