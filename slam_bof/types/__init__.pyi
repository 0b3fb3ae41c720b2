from .depth import (
    INVALID_DEPTH_MM as INVALID_DEPTH_MM,
    MAX_PIXELS as MAX_PIXELS,
    DepthFrame as DepthFrame,
    Intrinsics as Intrinsics,
    SensorParams as SensorParams,
    SubsampledDepth as SubsampledDepth,
)
from .features import (
    Bag as Bag,
    Contours as Contours,
    SavedConstellation as SavedConstellation,
    Scene as Scene,
)
from .keyframes import (
    Keyframe as Keyframe,
    KeyframeRecord as KeyframeRecord,
    OdometryState as OdometryState,
    Step as Step,
)
from .loops import (
    Candidate as Candidate,
    CandidateSource as CandidateSource,
    Decision as Decision,
    EdgeKind as EdgeKind,
    Loop as Loop,
    Verification as Verification,
)
from .parameters import (
    Params as Params,
)
from .poses import (
    LOST as LOST,
    Array as Array,
    FramePose as FramePose,
    Pose as Pose,
    Trajectory as Trajectory,
)
