from .bag_detector import (
    BagLoopDetector as BagLoopDetector,
)
from .candidate_checks import (
    LoopCounts as LoopCounts,
    RankedCandidates as RankedCandidates,
)
from .covisibility import (
    CovisibilityParams as CovisibilityParams,
    choose_covisible as choose_covisible,
    find_covisible as find_covisible,
)
from .decisions import (
    MapPoses as MapPoses,
    VerificationParams as VerificationParams,
)
from .detector import (
    LoopDetector as LoopDetector,
    make_loop_detector as make_loop_detector,
)
from .params import (
    LoopParams as LoopParams,
)
from .verification import (
    LoopVerification as LoopVerification,
    Verified as Verified,
)
from .view_detector import (
    ViewLoopDetector as ViewLoopDetector,
)
