from .export import (
    Format as Format,
    export_map as export_map,
    session_trajectory as session_trajectory,
)
from .map_localizer import (
    LocalizedFrame as LocalizedFrame,
    MapLocalizer as MapLocalizer,
    load_searched as load_searched,
)
from .map_session import (
    MapSession as MapSession,
    check_session as check_session,
    finish_map as finish_map,
    finish_session as finish_session,
    restore_session as restore_session,
    with_model_of as with_model_of,
)
from .map_view import (
    show_finished_map as show_finished_map,
    show_map as show_map,
)
from .merging import (
    merge_maps as merge_maps,
)
from .occupancy_grid import (
    OccupancyGrid as OccupancyGrid,
    OccupancyGridParams as OccupancyGridParams,
    build_occupancy_grid as build_occupancy_grid,
)
from .point_cloud import (
    write_sequence_cloud as write_sequence_cloud,
)
from .pose_uncertainty import (
    pose_covariances as pose_covariances,
)
