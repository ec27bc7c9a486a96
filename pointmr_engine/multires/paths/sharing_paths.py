"""Light that fragments ask for by rays and receive together: how often they ask, and where the answers go."""

from __future__ import annotations

import numpy as np

from pointmr_engine.multires.lobes.lobe_cones import WITHIN_LOBE
from pointmr_engine.multires.lobes.lobe_shares import look_where_lobes_do
from pointmr_engine.multires.paths.shadow_edges import EdgePaths
from pointmr_engine.multires.sharing.light_sharing import OF_WORLD
from pointmr_engine.multires.sharing.shared_light import BOUNCED, REFLECTED, REFRACTED, SharedLight
from pointmr_engine.multires.sharing.world_rays import (
    PEER_SUMS,
    SUMS,
    count_peers,
    first_rays,
    split_repeats,
    wanted_rays,
)
from pointmr_engine.raytracing.integrator import NEXT
from pointmr_engine.raytracing.lights import LAMP, WORLD
from pointmr_engine.raytracing.path_arrays import UNSHARED, allocate_samples
from pointmr_engine.shading.points import RAY_CAMERA, RAY_DIFFUSE, RAY_REFLECTION

MIRRORED = 4  # times as many rays to the world from what mirrors and clear glass show, which nothing shares


class SharingPaths(EdgePaths):
    """Paths from fragments that share what their rays find. light: ConeLight, what all threads share."""

    def __init__(self, stage, light, room: int):
        super().__init__(stage, room)
        self.light = light
        self.small = None  # (n,) bool, while first surfaces are lit: too small for cones
        self.shared_light = SharedLight(light, room)
        self.asks, self.begins = None, False  # lights that first surfaces ask for now; whether rays begin
        if self.shared_light.copies:
            self.every = allocate_samples((1 + self.shared_light.copies) * room)
        self.peers = np.ones(room)  # cones that share what a fragment receives
        self.asked = np.zeros(room, np.int64)  # rays to the world, or to one of many lights
        self.repeats = light.world_rays  # rays of a point behind first surfaces to the world: see MIRRORED
        self.looked, self.unlit = 0, None  # turns to one of many lights so far, and radiance before them

    def start_tile(self, space, count: int) -> None:
        super().start_tile(space, count)
        self.shared_light.start_tile(len(space.fragments.entry))

    def leave(self, then, n: int, base: int, count: int) -> None:
        if self.shared_light.copies:
            kind, side = then.state.kind[:n], np.zeros(n, np.int64)
            shared = (self.waiting_cones().alpha[:n] == WITHIN_LOBE) & (then.flags[:n] & UNSHARED == 0)
            reflects, diffuse = kind & RAY_REFLECTION != 0, kind & RAY_DIFFUSE != 0
            side[shared & reflects] = REFLECTED
            side[shared & reflects & diffuse] = BOUNCED
            side[shared & ~reflects & ~diffuse] = REFRACTED
            self.shared_light.separate(
                self.every, then.slot[:n], side, then.rays.direction[:n], self.first, base, count
            )

    def receive(self, first: int, base: int, count: int) -> None:
        super().receive(first, base, count)
        if self.shared_light.copies:
            self.shared_light.take_lobes(self.every, first, base, count)

    def choose_points(self, now, n: int, alive, bounce: int) -> int:
        m = super().choose_points(now, n, alive, bounce)
        look_where_lobes_do(
            self.lobes, self.lit_rows, np.int64(m), False, self.lit_normal, self.lit_transmissive
        )
        return m

    def _look_at_light(self, now, m: int, turn) -> None:
        if turn == (WORLD, 0):
            lit = self.lit_rows, self.lit_position, self.lit_normal, self.lit_transmissive, self.lit_u
            before = [a[:m].copy() for a in lit]
            rows, position, normal, transmissive, u = before
            kept = rows, position, normal.copy(), transmissive.copy(), u
            look_where_lobes_do(self.lobes, rows, np.int64(m), True, *kept[2:4])
            if self.small is None:  # behind first surfaces
                self.asked[:] = self.repeats
                if self.repeats > 1:
                    mirrored = (now.state.kind[: self.count] & RAY_CAMERA) == 0
                    self.asked[: self.count][mirrored] *= MIRRORED
                self._look_at_world(now, lit, kept, self.asked[kept[0]])
            else:
                self._look_as_worth(now, lit, kept)
            for now_, then in zip(lit, before, strict=True):
                now_[:m] = then
        elif turn is None and self.small is not None:
            self._look_at_many(now, m)
        else:
            super()._look_at_light(now, m, turn)

    def _look_at_many(self, now, m: int) -> None:
        """One ray of each point to one of many lights; with the last of them, more where they are worth it."""
        n, radiance, asked, shared = self.count, self.samples.radiance, self.asked, self.shared_light
        if self.looked == 0:
            self.unlit = radiance[:n].copy()
            self.open_light[:n] = 0.0
        self.measures = True
        self._ask_many(now, m)
        self.measures = False
        self.looked += 1
        turns = self.stage.lights.turns.count(None)
        if self.looked < turns:
            return
        self.looked = 0
        arrived = (radiance[:n] - self.unlit).sum(1) + shared.received_of_lamps(self.first, n)
        asked[:n] = turns
        self.peers[:n] = 1.0  # of what lamps bring, penumbras are noisy, which hardly share
        self._ask_as_worth(arrived, self.unlit.sum(1))
        lit = np.zeros(n, np.bool_)
        lit[self.lit_rows[:m]] = True
        # in turn, for lobes are shared with one sample of a point at a time
        for number in range(int(asked[:n][lit].max(initial=0)) - turns):
            some = self.choose_points(now, n, lit & (asked[:n] > turns + number), 0)
            self.shift_points(some, (len(self.stage.lights.turns) + number) * NEXT)
            self._ask_many(now, some)
        part = turns / asked[:n]
        radiance[:n] = self.unlit + (radiance[:n] - self.unlit) * part[:, None]
        shared.scale_lamps(part, self.first)

    def _ask_many(self, now, m: int) -> None:
        """A ray of each point to one of many lights, which fragments share."""
        self.asks, self.begins = LAMP, True
        super()._look_at_light(now, m, None)
        self.asks = None

    def _cone_widths(self, now, n: int) -> np.ndarray:
        """(n,) float64: how wide a cone is where it meets the batch's fragments, metres."""
        width = now.state.width[:n] + now.state.spread[:n] * self.hits.t[:n]
        return self.space.cone_widths(self.first, width.astype(np.float64))

    def _count_peers(self, now) -> None:
        """Fill `peers` with how many cones share what each of the batch's fragments receives of the world."""
        n, image, shares = self.count, self.space.image, self.shared_light.world
        self.peers[:n] = 1.0
        if len(shares.rays):
            count_peers(
                self.pixel, shares, np.int64(self.first), self._cone_widths(now, n),
                np.float64(image.subpixels // image.cone), OF_WORLD.turn, np.int64(n),
                np.empty((*self.space.used.shape, PEER_SUMS)), self.peers,
            )  # fmt: skip

    def _ask_as_worth(self, arrived, others) -> None:
        """Raise `asked` of the batch's fragments to what they are worth, by `open_light`: world_rays.wanted_rays."""
        n, (rows, columns) = self.count, self.space.used.shape
        wanted_rays(
            self.pixel, self.open_light[:n], arrived, others, self.space.fragments.count[self.first : self.first + n],
            np.float64(self.space.image.cone**2), np.float64(self.light.worth), self.peers,
            np.int64(n), np.empty((rows, columns, SUMS)), self.asked,
        )  # fmt: skip

    def _look_as_worth(self, now, lit, kept) -> None:
        """Ask the world as often as it is worth for each fragment; what arrives goes to those that share it."""
        n, radiance, asked = self.count, self.samples.radiance, self.asked
        subpixels = self.space.fragments.count[self.first : self.first + n]
        before = radiance[:n].copy()
        first_rays(subpixels, np.float64(self.space.image.cone**2), np.int64(n), asked)
        self.open_light[:n], self.measures = 0.0, True
        self.shared_light.begin_world(n)
        self._look_at_world(now, lit, kept, asked[kept[0]])
        self.measures = False
        self.shared_light.count_rays(asked[:n], self.first)
        arrived, done = (radiance[:n] - before).sum(1), asked[:n].copy()
        self._count_peers(now)
        self._ask_as_worth(arrived, before.sum(1))
        part = done / asked[:n]
        radiance[:n] = before + (radiance[:n] - before) * part[:, None]
        self.shared_light.scale_world(part, self.first)
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
            self.shift_points(total, number[:, None] * NEXT)
            if self.small is not None:
                self.asks, self.begins = WORLD, True
            super()._look_at_light(now, total, (WORLD, 0))
            self.asks = None

    def settle(self, count: int) -> int:
        shared, rays, met = self.shared_light, self.shadows, self.shadow_hits
        if self.asks == WORLD:
            if self.begins:
                shared.count_world_rays(rays, met, count, self.first)
            shared.note_world(rays, met, count, self.first)
        elif self.asks == LAMP:
            shared.take_lamps(rays, met, count, self.first, self.begins)
        self.begins = False  # those that pass a surface have been counted
        return super().settle(count)

    def finish_tile(self, count: int) -> None:
        """Radiance of the tile's fragments 0..count to space.light, with what they receive together."""
        super().finish_tile(count)
        self.shared_light.give(self.space, count)
