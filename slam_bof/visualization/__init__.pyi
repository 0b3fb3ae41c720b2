from .bof_figures import (
    draw_bof as draw_bof,
    draw_constellations as draw_constellations,
)
from .live_view import (
    LiveView as LiveView,
)
from .matrix_images import (
    draw_loop_matrix as draw_loop_matrix,
    write_png as write_png,
)
from .misses_page import (
    MissedQueries as MissedQueries,
    find_missed_queries as find_missed_queries,
    write_missed_queries as write_missed_queries,
)
from .plan import (
    Plan as Plan,
)
from .plan_figure import (
    draw_plan as draw_plan,
)
from .precision_recall_figure import (
    draw_precision_recall as draw_precision_recall,
)
from .report_data import (
    FrameHealth as FrameHealth,
    PicturedPair as PicturedPair,
    ReportData as ReportData,
)
from .rerun_recording import (
    LIVE as LIVE,
    MapSpace as MapSpace,
    RerunRecording as RerunRecording,
)
from .run_report import (
    write_report as write_report,
)
from .scene_page import (
    write_comparison as write_comparison,
)
