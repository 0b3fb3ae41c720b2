from .errors import SlamBofError as SlamBofError
from .places import PlaceRecogniser as PlaceRecogniser
from .slam import Config as Config, LoopCloser as LoopCloser, MiniSlam as MiniSlam
from .types import (
    Bag as Bag,
    DepthFrame as DepthFrame,
    Intrinsics as Intrinsics,
    Keyframe as Keyframe,
    Loop as Loop,
    Scene as Scene,
    Step as Step,
    Trajectory as Trajectory,
)

__version__: str
