"""States at edges: flat cones, lines next to the vertical; in both forms and both precisions.

`edges.json` holds states that one form once got wrong or left undecided, with what linear programs say of each
(`python -m tests.edge_values` prints it). The rest is laws: what slack may change, and what it may not.
"""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from samplers import rotation

import jaxcap
from jaxcap import Case, Status
from jaxcap.numerics.guarded import tolerances
from tests.edge_values import FACTORS

UP, DOWN = np.eye(3), np.diag([1.0, -1.0, -1.0])
RAYS, FACES = 128, 512
"""All contact sets here are padded to so many: compiled once for each form and precision."""
DTYPES = (np.float64, np.float32)
BAND = {np.float64: 1e-6, np.float32: 1e-3}
"""Of the speed."""
KNOWN_WRONG = {
    ("faces", np.float32): {"fuzz_3_point_any_float32_undec-r_1"},
    ("rays", np.float32): {"fuzz_3_point_any_float32_undec-r_1", "fuzz_2_nearflat_float32_undec-r_1"},
}
"""Entries that single precision still gets wrong: a CoM 1 m below a contact, to 1e-8 m, that moves straight up but for an
angle of 1e-5; and a contact set 0.2 mm wide. Whoever mends one takes it from here: the test asks for this list alone."""
ENTRIES = json.loads((Path(__file__).parent / "edges.json").read_text())
forms = pytest.mark.parametrize("form", ["faces", "rays"])
precisions = pytest.mark.parametrize("dtype", DTYPES, ids=lambda dtype: dtype.__name__)


def contact_set(points, frames, friction) -> jaxcap.ContactSet:
    return jaxcap.ContactSet(np.array(points, float), np.array(frames, float), friction)


def answers(form, dtype, states):
    """Of states (contact set, sides of its pyramids, com, velocity)."""
    sets, sides, coms, velocities = zip(*states, strict=True)
    with jax.enable_x64(dtype == np.float64):
        rounded = [
            jaxcap.ContactSet(*(np.asarray(x, dtype).astype(float) for x in (s.points, s.frames, s.friction))) for s in sets
        ]
        cone = {"faces": face_cone, "rays": ray_cone}[form]
        cones = [cone(one, n) for one, n in zip(rounded, sides, strict=True)]
        motion = [np.array(x, dtype) for x in (coms, velocities)]
        if form == "rays":
            own = jaxcap.ConeRays(*(np.stack(field) for field in zip(*cones, strict=True)))
            return jax.tree.map(np.asarray, jaxcap.score(own, *motion))
        found = [jaxcap.capturability(*one) for one in zip(cones, *motion, strict=True)]
        return jax.tree.map(lambda *fields: np.stack(fields), *found)


def face_cone(contacts, sides):
    cone = jaxcap.centroidal_cone(contacts, sides)
    return cone.padded(next(FACES * 4**k for k in range(6) if FACES * 4**k >= len(cone.faces)))


def ray_cone(contacts, sides):
    cone = jaxcap.cone_rays(contacts, sides)
    extra = RAYS - len(cone.mask)
    return cone._replace(rays=np.pad(cone.rays, ((0, extra), (0, 0))), mask=np.pad(cone.mask, (0, extra)))


@forms
@precisions
def test_what_linear_programs_say(form, dtype):
    """Of every entry of this precision: decided, and at three speeds no verdict that is true of no state nearby.

    But for those that are known.
    """
    entries = [entry for entry in ENTRIES if entry["dtype"] == dtype.__name__]
    assert len(entries) > 15
    states = [
        (contact_set(e["points"], e["frames"], np.array(e["friction"])), e["sides"], e["com"], e["com_velocity"])
        for e in entries
    ]
    found = answers(form, dtype, states)
    wrong = []
    for i, entry in enumerate(entries):
        if found.status[i] == Status.MAX_STEPS:
            wrong.append((entry["name"], "undecided"))
            continue
        speed = float(np.linalg.norm(np.array(entry["com_velocity"], dtype)))
        for factor, true in zip(FACTORS, entry["true"], strict=True):
            at = factor * speed
            claim = bool(found.max_speed[i] > 0 and found.min_speed[i] <= at <= found.max_speed[i])
            near = min(abs(found.max_speed[i] - at), abs(found.min_speed[i] - at)) <= BAND[dtype] * at
            if claim not in true and not near:
                wrong.append((entry["name"], factor, claim, float(found.margin[i])))
    assert {name for name, *_ in wrong} == KNOWN_WRONG.get((form, dtype), set()), wrong


FIST = ([[0, 0, 0.98], [0, 0, 1.02]], [UP, DOWN], 0.5)
FLAT = {  # contacts, a CoM that the cone can carry, and a direction along which nothing decelerates it
    "a fist on a rail": (FIST, [0.2, 0, 0.8], [0, 1, 0]),
    "a rail": (([[-0.4, 0, 0], [0.1, 0, 0], [0.4, 0, 0]], UP, 0.6), [0.1, 0, 0.5], [0, 1, 0]),
    "a pole": (
        ([[0, 0, 0.4], [0, 0, 0.8]], [rotation(0, np.pi / 2, 0), rotation(0, -np.pi / 2, 0)], 1.5),
        [0.3, 0, 0.6],
        [0, 1, 0],
    ),
    "one point": (([[0, 0, 0]], UP, 0.38), [0, 0, 0.7], [0.6, 0.8, 0]),
    "two points": (([[0, -0.2, 0], [0, 0.3, 0]], UP, 0.7), [0, 0.1, 0.9], [1, 0, 0]),
}
MOTIONS = {  # yaw [rad], shift [m], scale
    "as it is": (0.0, (0, 0, 0), 1.0),
    "turned": (0.7, (0, 0, 0), 1.0),
    "shifted": (0.0, (3.1, -7.7, 0.4), 1.0),
    "small": (2.1, (0, 0, 0), 0.01),
    "large": (-1.2, (1, 2, 3), 40.0),
}


def moved(case, motion, speed=0.5):
    """Contact set, sides, CoM and velocity of a case of FLAT, turned, shifted and scaled; velocities with the root."""
    ((points, frames, friction), com, direction), (yaw, shift, scale) = FLAT[case], MOTIONS[motion]
    turn = rotation(0, 0, yaw)
    place = lambda x: scale * np.array(x, float) @ turn.T + shift
    frames = turn @ np.broadcast_to(np.array(frames, float), (len(points), 3, 3))
    velocity = speed * np.sqrt(scale) * turn @ np.array(direction, float)
    return contact_set(place(points), frames, friction), 4, place(com), velocity


@forms
@precisions
def test_no_force_that_no_contact_gives_stops_a_robot(form, dtype):
    """However far away; the same for all yaws, shifts and scales."""
    cases = [(case, motion) for case in FLAT for motion in MOTIONS]
    found = answers(form, dtype, [moved(*case) for case in cases])
    for i, case in enumerate(cases):
        speed = 0.5 * np.sqrt(MOTIONS[case[1]][2])
        assert not found.capturable[i], case
        assert found.status[i] == Status.OK, case
        np.testing.assert_allclose(found.margin[i], -speed, rtol=BAND[dtype], err_msg=str(case))
        assert found.case[i] in (Case.C1, Case.C2), case


@forms
@precisions
def test_what_flat_cones_can_carry_they_do(form, dtype):
    """Along the rail, straight up above a point, around nothing: what decelerates there is real, and it counts."""
    rail, point = (FLAT["a rail"][0][0], UP, 2.0), FLAT["one point"][0]
    states = [
        (contact_set(*rail), 4, [0.1, 0, 0.5], [0.3, 0, 0]),  # as a foot in the plane: omega times the way to the end
        (contact_set(*point), 4, [0, 0, 0.7], [0, 0, 0.4]),  # free fall decelerates, and it lands where it stands
        (contact_set(*rail), 4, [0.1, 0, 0.5], [0, 0, -0.4]),
        (contact_set(*FIST), 4, [0, 0, 0.8], [0, 0, 0.5]),
    ]
    found = answers(form, dtype, states)
    assert found.capturable.all()
    np.testing.assert_allclose(found.max_speed[0], 0.3 * np.sqrt(9.81 / 0.5), rtol=BAND[dtype])
    assert np.isinf(found.margin[1:]).all()


FOOT = ([[0.1, 0.05, 0], [-0.1, 0.05, 0], [-0.1, -0.05, 0], [0.1, -0.05, 0]], UP, 0.8)
SIZE = float(np.hypot(0.1, 0.05))


@forms
@precisions
def test_slack_changes_verdicts_within_its_distance_only(form, dtype):
    """A CoM outside the edge by twenty times the slack, or inside: moving straight up, and as good as straight up.

    Outside it can not stand where it lands, nor hold its contacts on the way there.
    """
    away = 20 * tolerances(dtype).slack * (SIZE + 0.81)
    tilts = np.array([0, 1e3, 1e5]) * tolerances(dtype).slack
    states, inside = [], []
    for sign in (-1, 1):
        for tilt in tilts[: 3 if dtype == np.float64 else 2]:
            states.append((contact_set(*FOOT), 4, [0.1 + sign * away, 0, 0.8], [0, 0.3 * tilt, 0.3]))
            inside.append(sign < 0)
    found = answers(form, dtype, states)
    assert (found.status == Status.OK).all()
    np.testing.assert_array_equal(found.capturable, inside)


@forms
@precisions
def test_next_to_free_fall_slack_shrinks_with_the_force(form, dtype):
    """Next to free fall contacts carry next to nothing: gravity is no measure of what they may be wrong by.

    A CoM outside a sole by a tenth of its length, that flies up and, by an angle of 1e-5, away: what force there is has to
    point back to the sole, and would tip the robot over, however little is needed.
    """
    angles = np.linspace(-1.2, 1.2, 12)
    states = [(contact_set(*FOOT), 4, [0.12, 0, 0.8], [1e-5 * np.cos(a), 1e-5 * np.sin(a), 1.0]) for a in angles]
    found = answers(form, dtype, states)
    assert (found.status == Status.OK).all()
    assert not found.capturable.any()
    np.testing.assert_allclose(found.margin, -1, rtol=1e-6)
