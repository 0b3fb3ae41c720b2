from . import model as model
from .bag_classifier import (
    SceneClassifier as SceneClassifier,
)
from .classifiers import (
    MACHINES as MACHINES,
    Found as Found,
    MachineName as MachineName,
    make_machine as make_machine,
    search_svm as search_svm,
)
from .folds import (
    cut_stretches as cut_stretches,
    grouped_folds as grouped_folds,
    moments as moments,
)
from .hmm_filter import (
    UNKNOWN as UNKNOWN,
    SceneFilter as SceneFilter,
    SceneFilterParams as SceneFilterParams,
)
from .labeller import (
    BagLabeller as BagLabeller,
    Labeller as Labeller,
)
from .levelled_classifier import (
    LevelledView as LevelledView,
    LevelScenes as LevelScenes,
    look as look,
)
from .map_labels import (
    label_map as label_map,
)
from .model import (
    Model as Model,
    classifier_bytes as classifier_bytes,
)
from .room_segmentation import (
    Region as Region,
    RegionParams as RegionParams,
)
from .single_image import (
    label_image as label_image,
)
from .training import (
    Descriptors as Descriptors,
    TrainingFrame as TrainingFrame,
    describe_frames as describe_frames,
    fit_model as fit_model,
    train_model as train_model,
)
