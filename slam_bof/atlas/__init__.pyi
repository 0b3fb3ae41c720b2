from .atlas import (
    Atlas as Atlas,
    AtlasMatch as AtlasMatch,
    AtlasParams as AtlasParams,
)
from .atlas_localizer import (
    AtlasLocalization as AtlasLocalization,
    AtlasLocalizer as AtlasLocalizer,
)
from .keyframes import (
    DescribedKeyframes as DescribedKeyframes,
    describe_map as describe_map,
)
from .manifest import (
    AtlasMap as AtlasMap,
)
