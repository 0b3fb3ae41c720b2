from . import config as config
from .components import (
    MapParts as MapParts,
)
from .config import (
    Config as Config,
    PluginChoice as PluginChoice,
    preset as preset,
)
from .frame_history import (
    History as History,
)
from .keyframe_map import (
    KeyframeMap as KeyframeMap,
)
from .loop_closer import (
    LoopCloser as LoopCloser,
)
from .mini_slam import (
    MiniSlam as MiniSlam,
    SlamResult as SlamResult,
    of_session as of_session,
)
