"""A log and its robot in, rows for `jaxcap score` out: piece by piece, episode by episode.

A piece is read with some rows of its neighbours on either side, so that differences, smoothing and dwells are those of
the whole episode; where pieces are cut does not show.
"""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxcap.contacts.contact_set import ContactSet
from jaxcap.errors import InputError
from jaxcap.robots import checks
from jaxcap.robots.centroidal import check_units, rows_of
from jaxcap.robots.differences import differences, smoothed
from jaxcap.robots.episodes import Episode, episodes, recognised
from jaxcap.robots.ground import Flat, Ground, read_ground
from jaxcap.robots.layouts import Layout, layout_of
from jaxcap.robots.models import Robot, load
from jaxcap.robots.motion import Rows, Source, Velocities
from jaxcap.robots.slip import SPAN, slips
from jaxcap.robots.touch import Touching, decided, lasting
from jaxcap.robots.whole_body import Points, Soles, WholeBody, whole_body

PIECE = 1 << 15
"""Rows of an episode that are in memory at a time."""


class Options(NamedTuple):
    """What may be said about a log besides its layout."""

    friction: float = 0.5
    """Coefficient of all contacts."""
    ground: Ground | None = None
    """None: level, at the height where the soles of each episode stand."""
    velocities: str = "logged"
    """`logged`, and differences of what is not; or `differences` of everything."""
    smooth: int = 0
    """Rows of the Savitzky-Golay filter on differences; 0: none."""
    touching: Touching = Touching()
    strict: bool = False
    """What is doubtful is an error."""


class States(NamedTuple):
    """Rows for `jaxcap.score` and `jaxcap score`. World frame, z up."""

    t: Float[np.ndarray, " n"]
    """Time of the row [s]; `time` is what `jaxcap score` calls the time to the stop."""
    episode: np.ndarray
    """Names (n,)."""
    row: Int[np.ndarray, " n"]
    """Number in the episode."""
    com: Float[np.ndarray, "n 3"]
    """[m]"""
    com_velocity: Float[np.ndarray, "n 3"]
    """[m/s]"""
    angular_momentum: Float[np.ndarray, "n 3"]
    """About the CoM [kg m^2/s]."""
    contact_points: Float[np.ndarray, "n k 3"]
    """Of all patches, on the ground [m]; `contact_mask` says which touch."""
    contact_frames: Float[np.ndarray, "n k 3 3"]
    """Columns: tangent, tangent, normal pointing at the robot."""
    contact_friction: Float[np.ndarray, "n k"]
    contact_mask: Bool[np.ndarray, "n k"]
    configuration: Float[np.ndarray, "n nq"]
    """In Pinocchio's conventions: for pictures."""

    @property
    def contacts(self) -> ContactSet:
        """The contacts of all rows, as `jaxcap.cone_rays` takes them: (n, k), masked where a point does not touch."""
        return ContactSet.unchecked(self.contact_points, self.contact_frames, self.contact_friction, self.contact_mask)


class Log:
    """A log that is read. Iterating gives its `States` in pieces; then `notes` has what there is to say.

    Args:
        path: File or folder.
        robot: Whose log it is; with patches.
        layout: What its fields are; None: recognised by its fields.
        options: What else there is to say.

    Raises:
        InputError: Here if the layout is not known, while iterating if no row could be used, or for a note with `strict`.
    """

    def __init__(self, path: str | os.PathLike, robot: Robot, layout: Layout | None = None, options: Options = Options()):  # noqa: B008
        self.path, self.robot, self.options = Path(path), robot, options
        if not robot.patches:
            name = robot.model.name
            raise InputError(
                f"{name}: nobody said where it can touch, and its collision shapes show no feet (--feet FILE.yaml)"
            )
        self.layout = recognised(self.path) if layout is None else layout
        self._found: dict[str, list[str]] = {}
        self.episodes = 0
        """Episodes of which rows came out."""

    @property
    def notes(self) -> tuple[str, ...]:
        """A line for each kind of thing that was found, with the first episode that it was found in."""
        return tuple(
            found[0] + (f" (and in {len(found) - 1} more episode{'s' if len(found) > 2 else ''})" if len(found) > 1 else "")
            for found in self._found.values()
        )

    def about(self) -> dict[str, Any]:
        """Conventions, for the metadata of the output."""
        options, ground = self.options, self.options.ground
        return {
            "log": str(self.path),
            "robot": self.robot.model.name,
            "layout": self.layout.conventions(),
            "patches": {name: patch._asdict() for name, patch in self.robot.patches.items()},
            "friction": options.friction,
            "ground": "level, where the soles of each episode stand" if ground is None else type(ground).__name__,
            "velocities": options.velocities,
            "smooth": options.smooth,
            "touching": options.touching._asdict(),
            "configuration": "Pinocchio: base position, quaternion x, y, z, w, joints",
        }

    def __iter__(self) -> Iterator[States]:
        self._found, self.episodes, first = {}, 0, None
        for episode in episodes(self.path, self.layout):
            try:
                if isinstance(episode, InputError):
                    raise episode
                for number, piece in enumerate(self._pieces(episode)):
                    self.episodes += number == 0
                    yield piece
            except InputError as error:
                if self.options.strict:
                    raise
                first = first or error
                self._note("refused", str(error))
        if not self.episodes:
            raise first or InputError(f"{self.path}: no episodes")

    def _note(self, kind: str, words: str) -> None:
        self._found.setdefault(kind, []).append(words)

    def _pieces(self, episode: Episode) -> Iterator[States]:
        """The states of one episode."""
        source = Source(episode, self.layout, self.robot.model)
        if source.missing:
            self._say(
                source, [checks.Finding("missing", f"joints {', '.join(source.missing)} are not there, and held at zero")]
            )
        stepper = _Stepper(self.robot, source, self.options)
        for start in range(0, source.rows, PIECE):
            states, findings = stepper.step(start, min(start + PIECE, source.rows))
            self._say(source, findings)
            yield states._replace(episode=np.full(len(states.t), episode.name or episode.path.stem))

    def _say(self, source: Source, findings: list[checks.Finding]) -> None:
        """Notes what was found, once an episode; raises InputError for what is refused."""
        for finding in findings:
            words = f"{source.where}: {finding.words}"
            if finding.refused or self.options.strict:
                raise InputError(words if finding.refused else f"--strict: {words}")
            if not any(told.startswith(f"{source.where}: ") for told in self._found.get(finding.kind, ())):
                self._note(finding.kind, words)


class _Stepper:
    """Goes through one episode, and keeps what the next piece needs to know of the last one."""

    def __init__(self, robot: Robot, source: "Source | _Given", options: Options):
        self._robot, self._source, self._options = robot, source, options
        self._points = Points.of(robot.patches)
        self._ground = options.ground
        time = source.read(0, min(source.rows, 100)).time
        step = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
        self._dwell = int(np.ceil(options.touching.dwell / step - 1e-9)) if step > 0 else 1
        self._apart = max(1, round(SPAN / step)) if step > 0 else 1
        self._halo = 2 * self._dwell + options.smooth + 2
        self._before = np.zeros(len(robot.patches), dtype=bool)

    def step(self, start: int, stop: int) -> tuple[States, list[checks.Finding]]:
        """States of the rows from start to stop, and what was found in them."""
        model, options = self._robot.model, self._options
        low, high = max(0, start - self._halo), min(self._source.rows, stop + self._halo)
        rows = self._source.read(low, high)
        findings = [*checks.check_time(rows.time, low), *checks.check_norms(rows.norms, low)]
        if any(finding.refused for finding in findings):
            return _nothing(self._robot), findings
        moved = differences(model, rows.time, rows.configurations)
        findings += self._look(rows, moved, low)
        moved = smoothed(moved, options.smooth)
        v = moved if options.velocities == "differences" else _logged(rows.logged, moved)
        body = whole_body(
            model, self._robot.patches, Flat(0.0) if self._ground is None else self._ground, rows.configurations, v
        )
        soles = self._points.soles(body.feet)
        if self._ground is None:
            height = self._standing(soles)
            self._ground, findings = Flat(height), [*findings, *checks.check_ground(height)]
            body = body._replace(feet=body.feet.on_floor(height))
            soles = soles._replace(heights=soles.heights - height)
        findings += checks.check_soles(soles.heights, soles.speeds, soles.tilts, self._points.flat)
        touching = self._touching(rows, soles, low, stop)
        owner = self._points.patch
        mask = touching[:, owner] & (body.feet.heights - soles.heights[:, owner] < options.touching.level)
        findings += checks.check_contacts(touching)
        slipping = slips(rows.configurations, self._points.centres(body.feet), touching, self._apart)
        findings += checks.check_slips(slipping, list(self._robot.patches))
        findings += checks.check_support(body.states.com, body.feet.points, mask)
        keep = slice(start - low, stop - low)
        return _states(rows, body, mask, options.friction, keep, start), findings

    def _look(self, rows: Rows, moved: np.ndarray, low: int) -> list[checks.Finding]:
        """What can be seen without the links."""
        model, q = self._robot.model, rows.configurations
        found = [*checks.check_limits(model, q), *checks.check_upright(q), *checks.check_jumps(moved, low)]
        return found + (checks.check_velocities(rows.logged, moved, low) if self._options.velocities == "logged" else [])

    def _standing(self, soles: Soles) -> float:
        """Where the lowest sole is, in half of the rows in which it is slow [m]. soles: over a floor at zero."""
        lowest = soles.heights.argmin(axis=1)[:, None]
        height, speed = (np.take_along_axis(each, lowest, axis=1) for each in (soles.heights, soles.speeds))
        slow = speed < self._options.touching.slow
        return float(np.median(height[slow] if slow.any() else height))

    def _touching(self, rows: Rows, soles: Soles, low: int, stop: int) -> Bool[np.ndarray, "n p"]:
        """Which patches touch, by flags or by height and speed."""
        raw = decided(soles.heights, soles.speeds, self._options.touching, self._before)
        next_low = max(0, stop - self._halo)
        if next_low > low:
            self._before = raw[next_low - low - 1]
        patches = lasting(raw, self._dwell)
        for number, name in enumerate(self._robot.patches):
            patches[:, number] = rows.touching.get(name, patches[:, number])
        return patches


def _logged(logged: Velocities, moved: Float[np.ndarray, "n nv"]) -> Float[np.ndarray, "n nv"]:
    """Velocities as logged, and differences of what is not."""
    v = moved.copy()
    for part, columns in ((logged.linear, slice(0, 3)), (logged.angular, slice(3, 6)), (logged.joints, slice(6, None))):
        if part is not None:
            v[:, columns] = np.where(np.isnan(part), v[:, columns], part)
    return v


def _states(rows: Rows, body: WholeBody, mask: Bool[np.ndarray, "n k"], friction: float, keep: slice, start: int) -> States:
    """The rows of a piece, without its neighbours'."""
    states, feet = body.states, body.feet
    return States(
        t=rows.time[keep],
        episode=np.full(len(rows.time[keep]), ""),
        row=np.arange(start, start + len(rows.time[keep])),
        com=states.com[keep],
        com_velocity=states.com_velocity[keep],
        angular_momentum=states.angular_momentum[keep],
        contact_points=np.nan_to_num(feet.points[keep]),
        contact_frames=feet.frames[keep],
        contact_friction=np.full(mask[keep].shape, friction),
        contact_mask=mask[keep],
        configuration=rows.configurations[keep],
    )


def _nothing(robot: Robot) -> States:
    """No rows."""
    k = len(Points.of(robot.patches).patch)
    empty = lambda *shape: np.zeros((0, *shape))
    numbers = (empty(), np.full(0, ""), np.zeros(0, np.int64), empty(3), empty(3), empty(3))
    return States(*numbers, empty(k, 3), empty(k, 3, 3), empty(k), np.zeros((0, k), bool), empty(robot.model.nq))


def states(
    path: str | os.PathLike,
    robot: str | os.PathLike | Robot,
    layout: str | os.PathLike | Layout | None = None,
    ground: float | str | os.PathLike | Ground | None = None,
    **options: Any,
) -> States:
    """All rows of a log in memory; `Log` gives them in pieces, with notes.

    Args:
        path: File or folder.
        robot: Its name, its file, or itself.
        layout: Its name, its file, or itself; None: recognised.
        ground: Its height [m], its file, or itself; None: where the soles stand.
        **options: The other fields of `Options`.

    Raises:
        InputError: As `Log`.
    """
    layout = layout if layout is None or isinstance(layout, Layout) else layout_of(layout)
    pieces = list(Log(path, _robot(robot), layout, _options(ground, options)))
    return States(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))


def states_of(
    robot: str | os.PathLike | Robot,
    time: Float[np.ndarray, " n"],
    configurations: Float[np.ndarray, "n nq"],
    velocities: Float[np.ndarray, "n nv"] | None = None,
    ground: float | str | os.PathLike | Ground | None = None,
    **options: Any,
) -> States:
    """Rows to score from (q, v) that are there already, in Pinocchio's conventions: what a log of one episode gives.

    Args:
        robot: Its name, its file, or itself.
        time: (n,) increasing [s].
        configurations: (n, nq).
        velocities: (n, nv); None: by differences.
        ground: As for `states`, and so are the options.
        **options: The other fields of `Options`.

    Raises:
        InputError: For what a log would be refused for.
        ValueError: For wrong shapes, and values that are not finite.
    """
    robot, said = _robot(robot), _options(ground, options)
    stepper = _Stepper(robot, _Given(robot, time, configurations, velocities), said)
    found, findings = stepper.step(0, len(time))
    for finding in findings:
        if finding.refused or said.strict:
            raise InputError(finding.words)
    return found


def _robot(robot: str | os.PathLike | Robot) -> Robot:
    return robot if isinstance(robot, Robot) else load(robot)


def _options(ground: float | str | os.PathLike | Ground | None, others: dict[str, Any]) -> Options:
    read = read_ground(ground) if isinstance(ground, float | int | str | os.PathLike) else ground
    return Options(ground=read, **others)


class _Given:
    """(q, v) in the place of a log."""

    def __init__(self, robot: Robot, time: Any, configurations: Any, velocities: Any):
        model = robot.model
        q = rows_of("configurations", configurations, "nq", model.nq)
        check_units(model, q)
        v = None if velocities is None else rows_of("velocities", velocities, "nv", model.nv)
        self._time, self.rows = np.asarray(time, dtype=float), len(q)
        if not self.rows or self._time.shape != (self.rows,) or (v is not None and len(v) != self.rows):
            sizes = [len(self._time), self.rows, self.rows if v is None else len(v)]
            raise ValueError(f"time, configurations and velocities have {sizes} rows (expected as many, at least one)")
        self._norms = np.linalg.norm(q[:, 3:7], axis=1)
        self._q = np.concatenate([q[:, :3], q[:, 3:7] / self._norms[:, None], q[:, 7:]], axis=1)
        self._logged = Velocities(None, None, None) if v is None else Velocities(v[:, :3], v[:, 3:6], v[:, 6:])

    def read(self, start: int, stop: int) -> Rows:
        """Rows start to stop."""
        rows = slice(start, stop)
        logged = Velocities(*(None if part is None else part[rows] for part in self._logged))
        return Rows(self._time[rows], self._q[rows], self._norms[rows], logged, {})
