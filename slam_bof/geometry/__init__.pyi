from . import se3 as se3, trajectory as trajectory
from .camera import (
    PointParams as PointParams,
    back_project as back_project,
    points_camera as points_camera,
    points_camera_f32 as points_camera_f32,
)
from .depth_view import (
    View as View,
    in_steps as in_steps,
    make_view as make_view,
    thicken as thicken,
    thin as thin,
    view_points as view_points,
    view_stride as view_stride,
)
from .frustum import (
    view_overlap as view_overlap,
)
from .gravity import (
    GravityTracker as GravityTracker,
    down_of_map as down_of_map,
    level_frame as level_frame,
)
from .observability import (
    Observability as Observability,
    PosePrior as PosePrior,
    is_partial as is_partial,
    observe as observe,
    plane_information as plane_information,
    search_weak as search_weak,
)
from .projective_icp import (
    AlignmentParams as AlignmentParams,
    ViewAligner as ViewAligner,
)
from .registration_quality import (
    JudgementParams as JudgementParams,
    judge as judge,
    reject as reject,
)
from .trajectory import (
    read_kitti as read_kitti,
    read_tum as read_tum,
    spread_correction as spread_correction,
    write_kitti as write_kitti,
    write_tum as write_tum,
)
from .virtual_camera import (
    CloudCamera as CloudCamera,
)
from .visibility import (
    Agreement as Agreement,
    Coverage as Coverage,
)
