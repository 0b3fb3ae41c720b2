from .folder import (
    read_run as read_run,
)
from .job import (
    RunInterrupted as RunInterrupted,
    RunResult as RunResult,
)
from .many import (
    SequenceRun as SequenceRun,
    run_sequences as run_sequences,
)
from .options import (
    RunOptions as RunOptions,
)
from .plan import (
    read_plans as read_plans,
)
from .run import (
    resume_sequence as resume_sequence,
    run_sequence as run_sequence,
)
