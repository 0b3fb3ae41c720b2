from .figures import (
    draw_precision_recall as draw_precision_recall,
)
from .matrix_images import (
    draw_loop_matrix as draw_loop_matrix,
    write_png as write_png,
)
from .misses_page import (
    Missed as Missed,
    find_misses as find_misses,
    write_misses as write_misses,
)
from .run_report import (
    ReportData as ReportData,
    write_report as write_report,
)
from .scene_page import (
    write_comparison as write_comparison,
)
