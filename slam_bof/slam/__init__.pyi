from . import config as config
from .components import (
    MapComponents as MapComponents,
)
from .config import (
    Config as Config,
    PluginChoice as PluginChoice,
    preset as preset,
)
from .config_comments import (
    describe_parameters as describe_parameters,
    dump_with_comments as dump_with_comments,
    unit_of as unit_of,
)
from .frame_history import (
    FrameHistory as FrameHistory,
)
from .keyframe_map import (
    KeyframeMap as KeyframeMap,
)
from .loop_closer import (
    LoopCloser as LoopCloser,
)
from .map_outline import (
    MapOutline as MapOutline,
)
from .map_uncertainty import (
    MapUncertainty as MapUncertainty,
)
from .mini_slam import (
    MiniSlam as MiniSlam,
    SlamResult as SlamResult,
    of_session as of_session,
)
from .odometry_doubts import (
    OdometryCheck as OdometryCheck,
    find_odometry_doubts as find_odometry_doubts,
)
