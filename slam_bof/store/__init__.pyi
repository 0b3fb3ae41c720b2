from .integrity import (
    check_map as check_map,
)
from .map_components import (
    parts_of as parts_of,
)
from .map_store import (
    MapStore as MapStore,
    Session as Session,
    SessionResult as SessionResult,
)
from .map_writer import (
    MapWriter as MapWriter,
)
from .pruning import (
    prune_map as prune_map,
    redundant as redundant,
)
from .queries import (
    query_keyframes as query_keyframes,
    query_loops as query_loops,
    query_regions as query_regions,
)
from .recovery import (
    recover_map as recover_map,
)
from .replay import (
    read_records as read_records,
)
from .schema import (
    CHECKED as CHECKED,
)
