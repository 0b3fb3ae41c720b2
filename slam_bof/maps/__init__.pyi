from .export import (
    export_map as export_map,
    session_trajectory as session_trajectory,
)
from .map_localizer import (
    Located as Located,
    MapLocalizer as MapLocalizer,
)
from .merging import (
    merge_maps as merge_maps,
)
from .occupancy_grid import (
    OccupancyParams as OccupancyParams,
)
from .point_cloud import (
    write_map as write_map,
)
