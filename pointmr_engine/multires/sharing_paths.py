"""Light that fragments ask for by rays and receive together: how often they ask, and where the answers go."""

from __future__ import annotations

import numpy as np

from pointmr_engine.multires.lobe_view import WITHIN_LOBE
from pointmr_engine.multires.shadow_edges import EdgePaths
from pointmr_engine.multires.shared_light import SharedLight
from pointmr_engine.multires.world_rays import SUMS, first_rays, split_repeats, wanted_rays
from pointmr_engine.raytracing.integrator import NEXT
from pointmr_engine.raytracing.lights import LAMP, WORLD
from pointmr_engine.raytracing.paths import allocate_samples
from pointmr_engine.shading.points import RAY_REFLECTION


class SharingPaths(EdgePaths):
    """Paths from fragments that share what their rays find. light: ConeLight, what all threads share."""

    def __init__(self, stage, light, room: int):
        super().__init__(stage, room)
        self.light = light
        self.small = None  # (n,) bool, while first surfaces are lit: too small for cones
        self.shared_light = SharedLight(light, room)
        self.asks, self.begins = None, False  # lights that first surfaces ask for now; whether rays begin
        if light.shares_lobes:
            self.every = allocate_samples(2 * room)
        self.asked = np.zeros(room, np.int64)  # rays to the world
        self.world_light = None  # (N,) float64 of fragments without what hides it, while it is asked

    def start_tile(self, space) -> None:
        super().start_tile(space)
        self.shared_light.start_tile(len(space.fragments.entry))

    def leave(self, then, n: int, base: int, count: int) -> None:
        if self.light.shares_lobes:
            reflected = (then.state.kind[:n] & RAY_REFLECTION) != 0
            shared = reflected & (self.waiting_cones().alpha[:n] == WITHIN_LOBE)
            self.shared_light.separate(self.every, then.slot[:n], shared, base, count)

    def receive(self, first: int, base: int, count: int) -> None:
        super().receive(first, base, count)
        if self.light.shares_lobes:
            self.shared_light.take_lobes(self.every, first, base, count)

    def _look_at_light(self, now, m: int, turn) -> None:
        if turn != (WORLD, 0):
            if turn is None and self.small is not None:
                self.asks, self.begins = LAMP, True
            super()._look_at_light(now, m, turn)
            self.asks = None
            return
        lit = self.lit_rows, self.lit_position, self.lit_normal, self.lit_transmissive, self.lit_u
        kept = [a[:m].copy() for a in lit]
        if self.small is None:  # behind first surfaces
            self.asked[:] = self.light.world_rays
            self._look_at_world(now, lit, kept, self.asked[kept[0]])
        else:
            self._look_as_worth(now, lit, kept)
        for now_, then in zip(lit, kept, strict=True):
            now_[:m] = then

    def _look_as_worth(self, now, lit, kept) -> None:
        """Ask the world as often as it is worth for each fragment; what arrives goes to those that share it."""
        n, radiance, asked = self.count, self.samples.radiance, self.asked
        subpixels = self.space.fragments.count[self.first : self.first + n]
        before, whole = radiance[:n].copy(), np.float64(self.space.image.cone**2)
        first_rays(subpixels, whole, np.int64(n), asked)
        self.world_light = np.zeros(n)
        self._look_at_world(now, lit, kept, asked[kept[0]])
        open_light, self.world_light = self.world_light, None
        arrived, done = (radiance[:n] - before).sum(1), asked[:n].copy()
        rows, columns = self.space.used.shape
        wanted_rays(
            self.pixel, open_light, arrived, before.sum(1), subpixels, whole,
            np.float64(self.light.worth), np.int64(n), np.empty((rows, columns, SUMS)), asked,
        )  # fmt: skip
        radiance[:n] = before + (radiance[:n] - before) * (done / asked[:n])[:, None]
        self._look_at_world(now, lit, kept, asked[kept[0]] - done[kept[0]])
        self.shared_light.take_world(radiance, before, asked[:n], self.first)

    def _look_at_world(self, now, lit, kept, more: np.ndarray) -> None:
        """The last `more` (m,) of the rays that are `asked` of each of the points `kept`."""
        for part in split_repeats(more, len(self.lit_rows)):
            times = more[part]
            total = int(times.sum())
            if not total:
                continue
            for target, values in zip(lit, kept, strict=True):
                target[:total] = np.repeat(values[part], times, 0)
            number = np.arange(total) + np.repeat(self.asked[kept[0][part]] - np.cumsum(times), times)
            u = self.lit_u[:total]
            u += number[:, None] * NEXT
            u -= np.floor(u)
            if self.small is not None:
                self.asks, self.begins = WORLD, True
            super()._look_at_light(now, total, (WORLD, 0))
            self.asks = None

    def settle(self, count: int) -> int:
        shared, rays, met = self.shared_light, self.shadows, self.shadow_hits
        if self.asks == WORLD and self.begins:
            shared.count_world_rays(rays, met, count, self.first)
        elif self.asks == LAMP:
            shared.take_lamps(rays, met, count, self.first, self.begins)
        self.begins = False  # those that pass a surface have been counted
        return super().settle(count)

    def finish_tile(self, count: int) -> None:
        """Radiance of the tile's fragments 0..count to space.light, with what they receive together."""
        super().finish_tile(count)
        self.shared_light.give(self.space, count)
