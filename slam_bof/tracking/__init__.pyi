from .keyframe_selection import (
    KeyframeParams as KeyframeParams,
    KeyframeSelector as KeyframeSelector,
)
from .tracker import (
    Track as Track,
    Tracker as Tracker,
)
from .tracking_params import (
    TrackingParams as TrackingParams,
)
