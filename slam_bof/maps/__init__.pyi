from .export import (
    export_map as export_map,
    session_trajectory as session_trajectory,
)
from .map_localizer import (
    LocalizedFrame as LocalizedFrame,
    MapLocalizer as MapLocalizer,
)
from .merging import (
    merge_maps as merge_maps,
)
from .occupancy_grid import (
    OccupancyGridParams as OccupancyGridParams,
)
from .point_cloud import (
    write_sequence_cloud as write_sequence_cloud,
)
