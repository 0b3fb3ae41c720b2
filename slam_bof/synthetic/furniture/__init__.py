"""Furniture built of boxes and cylinders, each piece a little different with the generator.

A piece stands on z = 0 with its back on y = 0 and its front towards +y, x along the wall
and centred on 0. Metres.
"""

from collections.abc import Callable

import numpy as np

from slam_bof.synthetic.furniture.bathroom import (
    bathtub,
    shower,
    toilet,
    towel_rail,
    wash_basin,
    washing_machine,
)
from slam_bof.synthetic.furniture.comfort import armchair, bed, sofa, tv_stand
from slam_bof.synthetic.furniture.fixtures import (
    bin_,
    boxes,
    ceiling_lamp,
    floor_lamp,
    picture,
    plant,
    radiator,
    sconce,
    whiteboard,
)
from slam_bof.synthetic.furniture.kitchen import counter, fridge, stove
from slam_bof.synthetic.furniture.storage import (
    bookshelf,
    cabinet,
    coat_rack,
    console,
    nightstand,
    shoe_rack,
    wall_cabinet,
    wall_shelf,
    wardrobe,
)
from slam_bof.synthetic.furniture.tables import (
    banquet_set,
    chair,
    coffee_table,
    conference_set,
    desk,
    desk_rows,
    dining_set,
    office_chair,
)
from slam_bof.synthetic.meshes import Mesh

__all__ = [
    "Maker",
    "armchair",
    "banquet_set",
    "bathtub",
    "bed",
    "bin_",
    "bookshelf",
    "boxes",
    "cabinet",
    "ceiling_lamp",
    "chair",
    "coat_rack",
    "coffee_table",
    "conference_set",
    "console",
    "counter",
    "desk",
    "desk_rows",
    "dining_set",
    "floor_lamp",
    "fridge",
    "nightstand",
    "office_chair",
    "picture",
    "plant",
    "radiator",
    "sconce",
    "shoe_rack",
    "shower",
    "sofa",
    "stove",
    "toilet",
    "towel_rail",
    "tv_stand",
    "wall_cabinet",
    "wall_shelf",
    "wardrobe",
    "wash_basin",
    "washing_machine",
    "whiteboard",
]

Maker = Callable[[np.random.Generator], Mesh]
"""What makes a piece of furniture."""
