from .folder import (
    read_run as read_run,
)
from .plan import (
    read_plan as read_plan,
)
from .run import (
    RunInterrupted as RunInterrupted,
    RunResult as RunResult,
    resume_sequence as resume_sequence,
    run_sequence as run_sequence,
)
