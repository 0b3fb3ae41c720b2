from . import se3 as se3, trajectory as trajectory
from .camera import (
    PointParams as PointParams,
    back_project as back_project,
    checked_depth as checked_depth,
    checked_intrinsics as checked_intrinsics,
    points_camera as points_camera,
    points_camera_f32 as points_camera_f32,
    project as project,
    ray_slopes as ray_slopes,
)
from .compilation import (
    compile_alignment as compile_alignment,
)
from .conventions import AXES as AXES
from .depth_view import (
    DepthView as DepthView,
    make_view as make_view,
    quantize_depth as quantize_depth,
    restore_frame as restore_frame,
    subsample as subsample,
    view_points as view_points,
    view_stride as view_stride,
)
from .frustum import (
    view_overlap as view_overlap,
)
from .g2o import (
    GraphEdge as GraphEdge,
    loop_information as loop_information,
    step_sigmas as step_sigmas,
    write_g2o as write_g2o,
)
from .gravity import (
    GravityParams as GravityParams,
    GravityTracker as GravityTracker,
    down_of_map as down_of_map,
    level_frame as level_frame,
)
from .observability import (
    PrincipalDirections as PrincipalDirections,
    open_directions as open_directions,
)
from .projective_icp import (
    AlignmentParams as AlignmentParams,
    SurfacePairs as SurfacePairs,
    ViewAligner as ViewAligner,
)
from .registration_quality import (
    RegistrationQualityParams as RegistrationQualityParams,
    assess_registration as assess_registration,
    reject as reject,
)
from .trajectory import (
    delayed as delayed,
    nearest_stamps as nearest_stamps,
    read_kitti as read_kitti,
    read_tum as read_tum,
    spread_correction as spread_correction,
    warn_unknown as warn_unknown,
    write_kitti as write_kitti,
    write_tum as write_tum,
)
from .virtual_camera import (
    CloudCamera as CloudCamera,
    VirtualCameraParams as VirtualCameraParams,
    render as render,
)
from .visibility import (
    Agreement as Agreement,
    Coverage as Coverage,
)
from .weak_direction_search import (
    search_weak_directions as search_weak_directions,
)
