from .localizer import (
    Localization as Localization,
    Localizer as Localizer,
)
from .params import (
    RecogniserParams as RecogniserParams,
)
from .recogniser import (
    Compare as Compare,
    PlaceMatch as PlaceMatch,
    PlaceRecogniser as PlaceRecogniser,
)
from .saved_constellations import (
    restore_constellation as restore_constellation,
    save_constellation as save_constellation,
)
