from .localizer import (
    Localization as Localization,
    Localizer as Localizer,
)
from .recogniser import (
    Compare as Compare,
    PlaceRecogniser as PlaceRecogniser,
    RecogniserParams as RecogniserParams,
)
