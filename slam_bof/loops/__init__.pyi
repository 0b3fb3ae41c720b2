from .covisibility import (
    CovisibilityParams as CovisibilityParams,
    choose_covisible as choose_covisible,
)
from .decisions import (
    VerificationParams as VerificationParams,
)
from .detector import (
    LoopCounts as LoopCounts,
    LoopDetector as LoopDetector,
)
from .params import (
    LoopParams as LoopParams,
)
from .verification import (
    LoopVerification as LoopVerification,
    Verified as Verified,
)
