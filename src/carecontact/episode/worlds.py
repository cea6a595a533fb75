"""Worlds at t = 0 that are kept: an episode begins in one of them in milliseconds, and without it in half a second."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from carecontact.episode.randomization import World, calibration, settled_world, under_control, with_draws_of
from carecontact.errors import ConfigError
from carecontact.interface.robot import CARTESIAN_IMPEDANCE, CONTROLS
from carecontact.protocol.protocol import TrialSpec
from carecontact.sim.rendering import SceneRenderer

MOST_KEPT = 8
"""How many worlds ``Worlds`` keeps by default. One takes about 80 MiB: 21 of them are the spec, 16 MuJoCo's arena, 11
the compiled model."""
Key = tuple[str, str, int, str, str]
"""What decides a world: the hash of its protocol, its task, seed, salt, and the controller of its robot."""


class KeptWorld:
    """A compiled world with its renderer. It begins at t = 0 as often as it is put back."""

    def __init__(self, key: Key, spec: TrialSpec, world: World) -> None:
        """``world``: at t = 0."""
        self.key, self.control = key, key[-1]
        self.simulation, self.settled, self.model_sha256 = world
        self.protocol = with_draws_of(spec.protocol, self.simulation.protocol)
        """The protocol with the trial's draws: it says where the robot and the cameras are."""
        known = calibration(self.protocol, spec.seed, salt=spec.salt)
        self.renderer = SceneRenderer(self.simulation.model, protocol=self.protocol, calibration=known)
        self._state = self.simulation.integration_state()

    def put_back(self) -> None:
        """Begin again at t = 0, equal to the last bit to a world that was built for it."""
        self.simulation.put_back(self._state)
        self.renderer.renders.clear()


class Worlds:
    """The worlds of one process that no episode uses now, the ``most`` that were used last. Give one object to all its
    episodes; two of the same trial at once get two worlds."""

    def __init__(self, most: int = MOST_KEPT, *, prepare: Callable[[TrialSpec], World] | None = None) -> None:
        """
        Args:
            most: number of worlds to keep; 0 keeps none.
            prepare: builds a world at t = 0; by default ``settled_world``.

        Raises:
            ConfigError: ``most`` is no integer of at least 0.
        """
        given: object = most
        if not isinstance(given, int) or given < 0:
            raise ConfigError(f"Worlds.most: expected an integer of at least 0, got {given!r:.80}")
        self.most = most
        self._prepare = prepare or (
            lambda spec: settled_world(spec.protocol, task_id=spec.task_id, seed=spec.seed, salt=spec.salt)
        )
        self._kept: OrderedDict[Key, KeptWorld] = OrderedDict()

    def __len__(self) -> int:
        return len(self._kept)

    def take(
        self, spec: TrialSpec, control: str = CARTESIAN_IMPEDANCE, *, instead_of: KeptWorld | None = None
    ) -> KeptWorld:
        """Return a trial's world at t = 0, for one episode until it is given back. It replaces ``instead_of``, which is
        still taken where building fails (SceneError, SettleError)."""
        key = _key(spec, control)
        if instead_of is not None and instead_of.key == key:
            instead_of.put_back()
            return instead_of
        taken = self._kept.pop(key, None)
        if taken is not None:
            taken.put_back()
        elif CONTROLS[control].joint is None:
            taken = KeptWorld(key, spec, self._prepare(spec))
        else:
            taken, instead_of = self._under_control(key, spec, instead_of)
        if instead_of is not None:
            self.give_back(instead_of)
        return taken

    def _under_control(self, key: Key, spec: TrialSpec, other: KeptWorld | None) -> tuple[KeptWorld, KeptWorld | None]:
        """Return a world made of one under the Cartesian impedance, and what is left of ``other``."""
        free = other
        if free is None or free.key != _key(spec, CARTESIAN_IMPEDANCE):
            free = self.take(spec)
        simulation, model_sha256 = under_control(free.simulation, CONTROLS[key[-1]])
        free.renderer.close()
        made = KeptWorld(key, spec, (simulation, free.settled, model_sha256))
        return made, None if free is other else other

    def give_back(self, world: KeptWorld) -> None:
        """Keep a world for later, and let go of the one that was used least lately where there are too many."""
        if (other := self._kept.pop(world.key, None)) is not None:
            other.renderer.close()
        self._kept[world.key] = world
        while len(self._kept) > self.most:
            self._kept.popitem(last=False)[1].renderer.close()

    def clear(self) -> None:
        """Let go of all worlds, and close their renderers."""
        while self._kept:
            self._kept.popitem()[1].renderer.close()


def _key(spec: TrialSpec, control: str) -> Key:
    return spec.protocol.sha256, spec.task_id, spec.seed, spec.salt, control
