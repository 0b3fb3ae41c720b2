from .brisk import (
    make_brisk_tour as make_brisk_tour,
    write_brisk_tour as write_brisk_tour,
)
from .corridor import (
    make_corridor as make_corridor,
    make_corridor_tour as make_corridor_tour,
    write_corridor as write_corridor,
)
from .degenerate import (
    DEGENERATE_SCENES as DEGENERATE_SCENES,
    MOTIONS as MOTIONS,
    DegenerateCase as DegenerateCase,
    render_case as render_case,
)
from .depth_noise import (
    SENSORS as SENSORS,
    DepthSensor as DepthSensor,
)
from .disturbed import (
    Play as Play,
    darkened as darkened,
    drifted as drifted,
    in_pieces as in_pieces,
    uncut as uncut,
    without as without,
)
from .flat import (
    Flat as Flat,
    make_flat as make_flat,
    make_tour as make_tour,
)
from .furnisher import (
    distance_to_boxes as distance_to_boxes,
)
from .gallery import (
    RoomViews as RoomViews,
    make_gallery as make_gallery,
)
from .lidar import (
    Lidar as Lidar,
    LidarParams as LidarParams,
)
from .rooms import (
    FIRST_KINDS as FIRST_KINDS,
    PIECES as PIECES,
    ROOM_KINDS as ROOM_KINDS,
    make_room as make_room,
)
from .scene import (
    KINECT as KINECT,
    Scene3D as Scene3D,
)
from .sensor import (
    SensorModelParams as SensorModelParams,
    sense as sense,
)
from .tour import (
    Waypoint as Waypoint,
    camera_poses as camera_poses,
    spin as spin,
    walk as walk,
)
from .twin import (
    write_twin as write_twin,
)
from .views import (
    furnished_views as furnished_views,
    messy_views as messy_views,
    training_views as training_views,
)
from .writer import (
    write_flat as write_flat,
    write_sequence as write_sequence,
)
