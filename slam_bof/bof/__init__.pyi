from .bag_of_words import (
    PlaceDescriber as PlaceDescriber,
    PlaceParams as PlaceParams,
    descriptors as descriptors,
    layer_rows as layer_rows,
)
from .compression import (
    pack as pack,
    unpack as unpack,
)
from .constellation import (
    Constellation as Constellation,
    ConstellationParams as ConstellationParams,
    describe_constellation as describe_constellation,
)
from .constellation_matching import (
    MatchingParams as MatchingParams,
    PoseHypothesis as PoseHypothesis,
    match_constellations as match_constellations,
)
from .contours import (
    ContourParams as ContourParams,
    find_contours as find_contours,
)
from .descriptor import (
    BofParams as BofParams,
    describe as describe,
)
from .inverted_index import (
    InvertedIndex as InvertedIndex,
)
from .layers import (
    LayerParams as LayerParams,
    layer_images as layer_images,
)
from .vocabulary import (
    TfIdf as TfIdf,
    Vocabulary as Vocabulary,
    count_words as count_words,
)
