from .bag_of_words import (
    PlaceDescriber as PlaceDescriber,
    PlaceParams as PlaceParams,
    descriptors as descriptors,
    layer_rows as layer_rows,
)
from .compilation import (
    compile_bof as compile_bof,
)
from .compression import (
    pack as pack,
    unpack as unpack,
)
from .constellation import (
    N_HARMONICS as N_HARMONICS,
    Constellation as Constellation,
    ConstellationParams as ConstellationParams,
    PlacedBofs as PlacedBofs,
    describe_constellation as describe_constellation,
    place_bofs as place_bofs,
)
from .constellation_consensus import (
    Motions as Motions,
)
from .constellation_correspondences import (
    MatchingParams as MatchingParams,
)
from .constellation_index import (
    ConstellationIndex as ConstellationIndex,
    IndexParams as IndexParams,
)
from .constellation_matching import (
    ConstellationMatch as ConstellationMatch,
    camera_motions as camera_motions,
    match_constellations as match_constellations,
)
from .constellation_packing import (
    pack_constellation as pack_constellation,
    unpack_constellation as unpack_constellation,
)
from .contours import (
    ContourParams as ContourParams,
    find_contours as find_contours,
    layer_contours as layer_contours,
)
from .descriptor import (
    BofParams as BofParams,
    describe as describe,
)
from .indexed_view import (
    CONTOUR_BYTES as CONTOUR_BYTES,
    IndexedView as IndexedView,
    describer_id as describer_id,
    index_view as index_view,
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
