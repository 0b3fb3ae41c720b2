from . import download as download
from .depth_images import (
    CAMERA_FILE as CAMERA_FILE,
    is_image as is_image,
    read_depth_image as read_depth_image,
)
from .download import (
    Downloaded as Downloaded,
)
from .download_catalogue import (
    CATALOGUE as CATALOGUE,
    find_archives as find_archives,
)
from .labelled_frames import (
    LabelledFrame as LabelledFrame,
    LabelledSequence as LabelledSequence,
    frames_of as frames_of,
    open_labelled as open_labelled,
    open_sequences as open_sequences,
    parse_label as parse_label,
    read_label_file as read_label_file,
    read_split as read_split,
    sequence_names as sequence_names,
)
from .labelled_images import (
    has_groups as has_groups,
    read_image_table as read_image_table,
)
from .plausibility import (
    doubts_of_depth as doubts_of_depth,
    doubts_of_image as doubts_of_image,
    find_doubts as find_doubts,
)
from .realsense import (
    RealSense as RealSense,
)
from .recording import (
    CameraFrame as CameraFrame,
    FolderWriter as FolderWriter,
    RecordResult as RecordResult,
    record as record,
)
from .sequence_slice import (
    SequenceSlice as SequenceSlice,
    first_frame as first_frame,
)
from .synchroniser import (
    FramePoseSynchroniser as FramePoseSynchroniser,
    SynchroniserParams as SynchroniserParams,
)
