from . import registry as registry
from .arrays import (
    GrowingArray as GrowingArray,
)
from .bounded_yaml import parse_yaml as parse_yaml
from .checkpoint import (
    Checkpoint as Checkpoint,
    Restorable as Restorable,
)
from .cluster import on_cluster as on_cluster
from .compilation import (
    compiled as compiled,
    find_kept as find_kept,
)
from .failures import keep_going as keep_going
from .file_lock import lock_file as lock_file
from .files import (
    naming as naming,
    open_bytes as open_bytes,
    read_bytes as read_bytes,
    read_text as read_text,
    refuse_named_pipe as refuse_named_pipe,
)
from .images import decode_image as decode_image
from .interruption import unwrap_interruption as unwrap_interruption
from .native_libraries import (
    import_open3d as import_open3d,
    one_blas_thread as one_blas_thread,
    one_cpu as one_cpu,
    one_native_thread as one_native_thread,
    silenced as silenced,
)
from .npy import (
    open_npy as open_npy,
    parse_npy as parse_npy,
)
from .registry import (
    open_dataset as open_dataset,
)
from .timing import (
    StageClock as StageClock,
    Usage as Usage,
    machine_memory_mb as machine_memory_mb,
    peak_rss_mb as peak_rss_mb,
    rss_mb as rss_mb,
)
from .validation import (
    describe_error as describe_error,
    suggest as suggest,
)
