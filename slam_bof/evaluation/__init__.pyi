from .cost import (
    Cost as Cost,
    one_thread as one_thread,
)
from .group_methods import (
    GROUP_METHODS as GROUP_METHODS,
)
from .holdout_training import (
    TrainedSceneModel as TrainedSceneModel,
    train_scene_model as train_scene_model,
    train_words as train_words,
)
from .labeller_scores import (
    MAX_DOUBTFUL as MAX_DOUBTFUL,
    evaluate_labeller as evaluate_labeller,
    label_figures as label_figures,
)
from .localization_metrics import (
    pose_accuracy as pose_accuracy,
)
from .loop_metrics import (
    loop_errors as loop_errors,
    loop_precision as loop_precision,
    loop_recall as loop_recall,
    revisits as revisits,
    same_place as same_place,
)
from .odometry_calibration import (
    Calibration as Calibration,
    FrameMotion as FrameMotion,
    calibrate as calibrate,
    measure_motions as measure_motions,
)
from .paper_tables import (
    run_bench as run_bench,
)
from .place_benchmark import (
    evaluate_places as evaluate_places,
)
from .place_methods import (
    RECOGNISER as RECOGNISER,
    MethodScores as MethodScores,
)
from .place_protocol import (
    PlaceQueries as PlaceQueries,
    ProtocolParams as ProtocolParams,
    overlap_shares as overlap_shares,
)
from .retrieval_metrics import (
    RetrievalMetrics as RetrievalMetrics,
    retrieval_metrics as retrieval_metrics,
)
from .scene_benchmark import (
    SceneResult as SceneResult,
    compare_methods as compare_methods,
    compare_named_methods as compare_named_methods,
    split_officially as split_officially,
    split_rooms as split_rooms,
    split_sunrgbd as split_sunrgbd,
)
from .scene_groups import (
    cross_validate_groups as cross_validate_groups,
)
from .scene_methods import (
    make_methods as make_methods,
)
from .scene_metrics import (
    Roc as Roc,
    calibration_error as calibration_error,
    confusion as confusion,
    reliability as reliability,
    roc as roc,
    scene_accuracy as scene_accuracy,
)
from .scene_splits import (
    Split as Split,
    split_at_random as split_at_random,
    split_by_group as split_by_group,
    split_by_time as split_by_time,
)
from .trajectory_metrics import (
    align_trajectory as align_trajectory,
    associate as associate,
    ate as ate,
    nees as nees,
    rpe as rpe,
)
