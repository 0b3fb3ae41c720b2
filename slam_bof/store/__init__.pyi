from .integrity import (
    check_map as check_map,
    require_intact as require_intact,
)
from .map_components import (
    choose_component as choose_component,
    components_of as components_of,
    largest_component as largest_component,
)
from .map_reader import (
    Session as Session,
)
from .map_store import (
    MapStore as MapStore,
    SessionResult as SessionResult,
)
from .map_writer import (
    MapWriter as MapWriter,
)
from .pruning import (
    find_redundant_keyframes as find_redundant_keyframes,
    prune_map as prune_map,
)
from .queries import (
    query_keyframes as query_keyframes,
    query_loops as query_loops,
    query_rooms as query_rooms,
)
from .recovery import (
    recover_map as recover_map,
)
from .replay import (
    replay_keyframes as replay_keyframes,
)
from .schema import (
    KEY_COLUMNS as KEY_COLUMNS,
)
