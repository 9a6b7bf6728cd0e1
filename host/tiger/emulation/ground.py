"""From a scenario's [terrain] to the terrain that the 14-DOF vehicle drives on."""

from __future__ import annotations

from dataclasses import replace
from math import radians, tan
from typing import TYPE_CHECKING

import numpy as np

from tiger.models.road import LEFT, RIGHT, iso_road
from tiger.models.terrain import Terrain

if TYPE_CHECKING:
    from tiger.emulation.scenarios import RoadConfig, TerrainConfig

ROAD_SPACING_M = 0.05


def make_terrain(config: TerrainConfig, half_track_m: float) -> Terrain:
    """Return the ground; a road's two profiles lie `half_track_m` left and right of y = 0."""
    if config.rough is not None:
        rough = config.rough
        ground = Terrain.random(
            rough.roughness, rough.seed, rough.size_m, shortest_wave_m=rough.shortest_wave_m
        )
    elif config.road is not None:
        ground = _road(config.road, half_track_m)
    else:
        ground = Terrain()
    ground = replace(
        ground,
        slope_x=tan(radians(config.climb_deg)),
        slope_y=tan(radians(config.left_up_deg)),
        twist_per_m=tan(radians(config.twist_deg_per_m)),
    )
    for bump in config.bump:
        ground = ground.with_bump(**bump.model_dump())
    for step in config.step:
        ground = ground.with_plate(**step.model_dump())
    for patch in config.slippery:
        ground = ground.with_slippery(**patch.model_dump())
    return ground


def _road(config: RoadConfig, half_track_m: float) -> Terrain:
    road = iso_road(config.roughness, config.seed)
    place_m = np.arange(0.0, config.length_m, ROAD_SPACING_M)
    left, right = (road.height_m(place_m, lane) for lane in (LEFT, RIGHT))
    return Terrain.from_tracks(left, right, ROAD_SPACING_M, half_track_m)
