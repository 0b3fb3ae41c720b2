from . import model as model
from .augmentation import (
    remeasure as remeasure,
    remeasure_labelled as remeasure_labelled,
)
from .bag_classifier import (
    SceneClassifier as SceneClassifier,
)
from .classifiers import (
    CLASSIFIERS as CLASSIFIERS,
    ClassifierName as ClassifierName,
    SvmParams as SvmParams,
    make_classifier as make_classifier,
    search_svm as search_svm,
)
from .constellation_classifier import (
    ConstellationClassifier as ConstellationClassifier,
)
from .contour_tokens import (
    bof_tokens as bof_tokens,
    turned_tokens as turned_tokens,
)
from .folds import (
    cut_segments as cut_segments,
    frame_groups as frame_groups,
    make_folds as make_folds,
)
from .frame_features import (
    LevelledFeatures as LevelledFeatures,
    levelled_features as levelled_features,
)
from .furniture_network import (
    FurnitureNetwork as FurnitureNetwork,
)
from .furniture_training import (
    FurnitureTraining as FurnitureTraining,
    FurnitureView as FurnitureView,
    fit_furniture as fit_furniture,
    furniture_view as furniture_view,
)
from .hmm_filter import (
    UNKNOWN_LABEL as UNKNOWN_LABEL,
    SceneFilter as SceneFilter,
    SceneFilterParams as SceneFilterParams,
)
from .labeller import (
    BagLabeller as BagLabeller,
    Labeller as Labeller,
)
from .levelled_classifier import (
    N_WORDS as N_WORDS,
    LevelledClassifier as LevelledClassifier,
    room_network as room_network,
)
from .map_labels import (
    label_map as label_map,
)
from .model import (
    Model as Model,
)
from .room_segmentation import (
    MapRoom as MapRoom,
    RoomSegmentationParams as RoomSegmentationParams,
)
from .set_transformer_training import (
    TransformerTraining as TransformerTraining,
    fit_transformer as fit_transformer,
    import_torch as import_torch,
)
from .single_image import (
    label_frame as label_frame,
    label_image as label_image,
)
from .stored_classifier import (
    classifier_bytes as classifier_bytes,
)
from .training import (
    FrameDescriptors as FrameDescriptors,
    TrainingFrame as TrainingFrame,
    continue_model as continue_model,
    describe_frames as describe_frames,
    fit_model as fit_model,
    train_model as train_model,
)
