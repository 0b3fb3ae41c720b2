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
