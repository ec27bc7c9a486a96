"""What a thread's fragments receive together: light of the world, of lamps that rays ask for, what rays in rough
lobes find, and what surfaces send each other. Each kind is gathered by itself, for each changes along a surface in its
own way (light_sharing).
"""

from __future__ import annotations

import math

import numpy as np

from pointmr_engine.multires.sharing.light_shares import (
    MOST_DIFFUSE,
    allocate_shares,
    begin_shares,
    count_blocked,
    count_lobe_rays,
    count_near,
    keep_own,
    take_bounced,
    take_light,
    take_reflected,
    take_turns,
)
from pointmr_engine.multires.sharing.light_sharing import (
    OF_LAMPS,
    OF_LOBE,
    OF_REFRACTION,
    OF_WORLD,
    share_light,
)
from pointmr_engine.raytracing.lights import LAMP

CLOSEST = 0.5  # widths of a cone: how near things may be for what they do to light
# angle from which light of the world counts as coming: what a small sun lights besides its sky is to be shared, too
NARROWEST = 0.1
POINT_WIDTH = 0.01  # of light from one direction: nothing is as sharp as it in an image
# of the way against the distance of what a lobe's rays met: how much of what it sees changes
MOVE_OF_LOBE = 0.25
# what sent a first ray whose light fragments share: a lobe that reflects, one that refracts, or a diffuse one
REFLECTED, REFRACTED, BOUNCED = 1, 2, 3


def numbers_of_equal(values: np.ndarray) -> np.ndarray:
    """Of values (n,) of which equal ones lie side by side: how many equal ones lie before each."""
    at = np.arange(len(values))
    begins = np.ones(len(values), np.bool_)
    begins[1:] = values[1:] != values[:-1]
    return at - np.maximum.accumulate(np.where(begins, at, 0))


class SharedLight:
    """One thread's shares. Rows are the tile's fragments; a batch is its fragments first..first + n.

    world, lamps, lobes, refractions, bounces: Shares, empty where there is nothing of the kind. `room`: samples of
    fragments under way at once; rays that are shared bring their light to samples of their own, `room` rows behind
    those of their fragments: of lobes that reflect, behind these of those that refract, and then a copy for each of a
    fragment's diffuse rays.
    """

    def __init__(self, light, room: int):
        self.has_world, self.has_lamps, self.has_lobes = (
            light.shares_world, light.shares_lamps, light.shares_lobes
        )  # fmt: skip
        self.has_refractions = self.has_lobes and light.shares_refractions
        self.has_bounces = light.shares_bounces
        # copies of samples that each of these has, and which is its first; copy 0: the samples themselves
        times = np.array([0, self.has_lobes, self.has_refractions, MOST_DIFFUSE * self.has_bounces], np.int64)
        self.copy_of = np.where(times > 0, 1 + np.cumsum(times) - times, 0)
        self.room, self.copies, self.fragments = room, int(times.sum()), 0
        self.world = self.lamps = self.lobes = self.refractions = self.bounces = allocate_shares(0)
        self.lobe_rays, self.lobe_near = np.zeros((2, self.copies * room), np.float32)
        self.towards = np.zeros((times[BOUNCED] * room, 3))  # where diffuse rays go
        self.own = np.zeros((room if self.has_world else 0, 3))  # of the world's light, what is not shared
        self.lamp_width = np.ones(room)
        self.closest, self.lobe_closest = np.zeros(room, np.float32), np.zeros(self.copies * room, np.float32)
        self.mis = light.lights.arrays.lamps.mis
        self.world_width = max(light.lights.environment.map.width, NARROWEST)

    def start_tile(self, fragments: int) -> None:
        """Room for the fragments of a tile."""
        if fragments == self.fragments:
            return
        self.fragments = fragments
        if self.has_world:
            self.world = allocate_shares(fragments)
        if self.has_lamps:
            self.lamps = allocate_shares(fragments)
        if self.has_lobes:
            self.lobes = allocate_shares(fragments)
        if self.has_refractions:
            self.refractions = allocate_shares(fragments)
        if self.has_bounces:
            self.bounces = allocate_shares(fragments)

    def begin(self, lobes, throughput, position, bounced: np.ndarray, first: int, n: int) -> None:
        """The fragments of a batch have received nothing but by lobes that begin as they scatter.

        bounced (n,): how many diffuse rays of each are on their way, on average.
        """
        for shares, width in ((self.world, self.world_width), (self.lamps, 1.0), (self.bounces, 1.0)):
            if len(shares.rays):
                begin_shares(lobes, throughput, position, width, np.int64(first), np.int64(n), shares)
        if self.has_bounces:
            self.bounces.worth[first : first + n] = bounced

    def see(self, width: np.ndarray) -> None:
        """The batch's fragments are seen by cones of that width (n,), metres."""
        self.closest[: len(width)] = np.maximum(CLOSEST * width, 1e-30)

    def of_lamps(self, chosen, rows: np.ndarray) -> None:
        """Remember from how wide an angle the light of samples `chosen` comes, for the batch's points `rows`.

        Without knowing how large each light is: the solid angle that a sample stands for is that of a light, over the
        chance that the light was chosen, which the number of samples makes up for.
        """
        width = np.sqrt(1.0 / (2.0 * math.pi * np.maximum(chosen.pdf * chosen.times, 1e-12)))
        lamps = np.flatnonzero(chosen.kind == LAMP)
        width[lamps[~self.mis[chosen.index[lamps]]]] = 0.0
        self.lamp_width[rows] = np.clip(width, POINT_WIDTH, 1.0)

    def count_world_rays(self, shadows, hits, count: int, first: int) -> None:
        """Note how near things are that rays 0..count to the world met."""
        count_near(
            shadows.source, hits.triangle, hits.t, self.closest, np.int64(count), np.int64(first), self.world
        )

    def count_rays(self, rays: np.ndarray, first: int) -> None:
        """Note how many rays (n,) a batch's fragments have sent to the world."""
        own = slice(first, first + len(rays))
        self.world.rays[own] = self.world.worth[own] = rays

    def take_world(self, radiance, before, rays: np.ndarray, first: int) -> None:
        """What a batch's radiance has gained since `before` is shared; rays (n,): how many brought it."""
        self.count_rays(rays, first)
        take_light(radiance, before, self.own, np.int64(first), np.int64(len(rays)), self.world)

    def begin_world(self, n: int) -> None:
        """A batch's n fragments are about to ask the world."""
        self.own[:n] = 0.0

    def note_world(self, shadows, hits, count: int, first: int) -> None:
        """Note how what rays 0..count to the world bring changes as surfaces turn, and what of it is not shared."""
        n = np.int64(count)
        keep_own(shadows.light, shadows.matt, shadows.glossy, shadows.source, hits.triangle, n, self.own)
        take_turns(
            shadows.matt, shadows.rays.direction, shadows.source, hits.triangle, n, np.int64(first), self.world,
        )  # fmt: skip

    def scale_world(self, part: np.ndarray, first: int) -> None:
        """Scale what note_world has noted of a batch's fragments by part (n,): more rays than planned will bring it."""
        self.world.turned[first : first + len(part)] *= part[:, None].astype(np.float32)
        self.own[: len(part)] *= part[:, None]

    def take_lamps(self, shadows, hits, count: int, first: int, counts: bool) -> None:
        """What shadow rays 0..count bring that nothing stops is shared; `counts`: these rays begin."""
        n, at = np.int64(count), np.int64(first)
        for shares, part in ((self.lamps, shadows.matt), (self.lobes, shadows.glossy)):
            if not len(shares.rays):
                continue
            if counts:
                count_blocked(
                    shadows.source, hits.triangle, hits.t, shadows.rays.t_max, self.lamp_width, self.closest, n, at,
                    shares,
                )  # fmt: skip
            take_reflected(shadows.light, part, shadows.source, hits.triangle, n, at, shares)

    def received_of_lamps(self, first: int, n: int) -> np.ndarray:
        """(n,) sums of channels of what a batch's fragments share of lamps, before lobes' rays bring more."""
        own = slice(first, first + n)
        return sum(
            (s.light[own].sum(1, np.float64) for s in (self.lamps, self.lobes) if len(s.rays)), np.zeros(n)
        )

    def scale_lamps(self, part: np.ndarray, first: int) -> None:
        """Scale what a batch's fragments have of lamps by part (n,): more rays than planned have brought it.

        They are not worth more to their neighbours for it: who asks more hangs on what these have found.
        """
        own = slice(first, first + len(part))
        for shares in (self.lamps, self.lobes):
            if len(shares.rays):
                shares.light[own] *= part[:, None].astype(np.float32)

    def separate(
        self, samples, slots: np.ndarray, side: np.ndarray, direction, first: int, base: int, count: int
    ) -> None:
        """Paths with slots (n,) that are shared get samples of their own, copies of base..base + count.

        side (n,) int: REFLECTED, ..., or 0 of those that are not; direction (n, 3): of their rays. Bounces are not of
        fragments that share none; theirs begin with `first`.
        """
        own, copy = slice(base, base + count), self.copy_of[side]
        if self.has_bounces:
            rows = np.flatnonzero(side == BOUNCED)
            shares = self.bounces.albedo[first + slots[rows] - base].max(1) > 0.0
            copy[rows[~shares]] = 0
            rows = rows[shares]
            number = numbers_of_equal(slots[rows])
            copy[rows] += number
            self.towards[slots[rows] + self.room * number] = direction[rows]
        for k in range(self.copies):
            rays, copies = (slice(k * self.room + base, k * self.room + base + count) for k in (k, k + 1))
            for column in samples:
                column[copies] = column[own]
            samples.radiance[copies] = 0.0
            self.lobe_closest[rays] = self.closest[:count]
            self.lobe_rays[rays] = self.lobe_near[rays] = 0.0
        slots += (self.room * copy).astype(slots.dtype)

    def count_lobe_rays(self, slots, hits, n: int) -> None:
        """Note what paths 0..n with samples of their own met first."""
        count_lobe_rays(
            slots, hits.triangle, hits.t, self.lobe_closest, np.int64(n), np.int64(self.room), self.lobe_rays,
            self.lobe_near,
        )  # fmt: skip

    def take_lobes(self, samples, first: int, base: int, count: int) -> None:
        """What the rays of fragments first..first + count have found is shared; their samples begin at `base`."""
        for side, shares in ((REFLECTED, self.lobes), (REFRACTED, self.refractions)):
            if len(shares.rays):
                found = self._take_copy(self.copy_of[side], samples, shares, MOVE_OF_LOBE, first, base, count)
                shares.light[first : first + count] += found
        for number in range(MOST_DIFFUSE * int(self.has_bounces)):
            shares, copy = self.bounces, self.copy_of[BOUNCED] + number
            found = self._take_copy(copy, samples, shares, 1.0, first, base, count)
            begin = number * self.room + base
            take_bounced(found, self.towards[begin : begin + count], np.int64(first), np.int64(count), shares)

    def _take_copy(self, copy, samples, shares, move: float, first: int, base: int, count: int) -> np.ndarray:
        """What rays with that copy of samples met counts for `shares`; returns (count, 3) what they have found."""
        begin = (copy - 1) * self.room + base
        to, own = slice(first, first + count), slice(begin, begin + count)
        shares.rays[to] += self.lobe_rays[own]
        shares.nearness[to] += np.float32(move) * self.lobe_near[own]
        return samples.radiance[self.room + begin : self.room + begin + count]

    def give(self, space, count: int) -> None:
        """Add what the tile's fragments 0..count receive together to space.light."""
        f, image = space.fragments, space.image
        side = image.subpixels // image.cone
        shape = tuple(side * n for n in space.used.shape)
        for change, shares in (
            (OF_WORLD, self.world), (OF_LAMPS, self.lamps), (OF_LOBE, self.lobes), (OF_REFRACTION, self.refractions),
            (OF_WORLD, self.bounces),
        ):  # fmt: skip
            if len(shares.rays):
                eye = image.camera.world_from_camera[:, 3]
                if not image.view.perspective:
                    eye, change = shares.position[0], change._replace(view=0.0)
                share_light(f.x, f.y, image.cone, change, shares, count, shape, eye, space.light)
