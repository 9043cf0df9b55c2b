"""Ground that is not level: its shape, the way of a vehicle on it, and what an IMU reads there."""

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from icreckon import Patch, Scenario, SimulationError, Terrain, load_robot
from icreckon.estimator.base.frames import wrap_angle
from icreckon.estimator.motion.icr import GRAVITY
from icreckon.simulation.base.sampling import sample_times
from icreckon.simulation.sensors.imu import angular_velocities, specific_forces
from icreckon.simulation.simulate import Simulation, run_scenario
from icreckon.simulation.truth.friction import on_surface
from icreckon.simulation.truth.surface_kernel import Surface, gradient
from icreckon.simulation.truth.terrain import draw_surface
from icreckon.simulation.truth.true_motion import TrueMotion, true_motion

ALPHA = load_robot("auriga-alpha")
LENGTH = 2.0 * ALPHA.vehicle.half_contact_length
STEP = 0.005
ROUGH = Terrain(
    slope_deg=3.0,
    uphill_deg=30.0,
    rolling_deg=5.0,
    wavelength=8.0,
    kerb_height=0.04,
    kerb_every=3.0,
)
EXACT = Scenario(duration=20.0, noise="perfect", truth_spread=0.0, seed=2)


def surface_of(terrain: Terrain, seed: int = 0) -> Surface:
    return draw_surface(terrain, LENGTH, np.random.default_rng(seed))


def height(surface: Surface, x: float, y: float) -> float:
    """Height of the ground [m]: plane, waves, and kerbs that go up and down in turn."""
    cos, sin = surface.direction
    u, v = cos * x + sin * y, cos * y - sin * x
    number, (u_phase, v_phase, kerb_phase) = surface.wave_number, surface.phases
    waves = surface.waves / number * (np.sin(number * u + u_phase) + np.sin(number * v + v_phase))
    place = u / surface.kerb_every + kerb_phase
    share = min(place % 1.0 * surface.kerb_every / surface.kerb_length, 1.0)
    risen = share - np.sin(2.0 * np.pi * share) / (2.0 * np.pi)
    goes_down = np.floor(place) % 2.0 == 1.0
    kerbs = surface.kerb_height * (1.0 - risen if goes_down else risen)
    return float(surface.plane * u + waves + kerbs)


def run(terrain: Terrain, **changes: Any) -> Simulation:
    return run_scenario(msgspec.structs.replace(EXACT, terrain=terrain, **changes), ALPHA)


def varied() -> TrueMotion:
    t = np.arange(0.0, 30.0 + 0.5 * STEP, STEP)
    return true_motion(1.0 / STEP, twists_at(t), np.zeros((len(t), 2)), "made")


def twists_at(t: np.ndarray) -> np.ndarray:
    return np.stack([0.5 + 0.3 * np.sin(t), 0.05 * np.cos(0.7 * t), 0.8 * np.sin(0.4 * t)], axis=-1)


@settings(max_examples=60)
@given(st.floats(-30.0, 30.0), st.floats(-30.0, 30.0), st.floats(-180.0, 180.0), st.integers(0, 99))
def test_the_gradient_is_the_derivative_of_the_height(x, y, uphill, seed):
    surface = surface_of(msgspec.structs.replace(ROUGH, uphill_deg=uphill), seed)
    step = 1e-5
    found = [
        (height(surface, x + d_x, y + d_y) - height(surface, x - d_x, y - d_y)) / (2.0 * step)
        for d_x, d_y in ((step, 0.0), (0.0, step))
    ]
    assert gradient(surface, x, y) == pytest.approx(found, abs=1e-7)


def test_rolling_ground_is_as_steep_and_as_long_as_stated() -> None:
    surface = surface_of(Terrain(rolling_deg=8.0, wavelength=20.0))
    places = np.arange(0.0, 40.0, 0.25)
    slopes = [np.hypot(*gradient(surface, x, y)) for x in places for y in places]
    assert np.degrees(np.arctan(max(slopes))) == pytest.approx(8.0, abs=0.02)
    assert height(surface, 3.0, 5.0) == pytest.approx(height(surface, 23.0, -15.0), abs=1e-12)
    # It rises and falls: no plane is left over.
    heights = [height(surface, x, y) for x in places[:80] for y in places[:80]]
    assert np.mean(heights) == pytest.approx(0.0, abs=1e-9)


def test_an_independent_integration_of_the_geometry_gives_the_same_way() -> None:
    """Heading and place by the differential equations of a tangent frame, in SciPy."""
    surface, motion = surface_of(ROUGH), varied()

    def rates(t: float, state: np.ndarray) -> list[float]:
        x, y, yaw, _ = state
        v_x, v_y, w = twists_at(np.array(t))
        cos, sin = np.cos(yaw), np.sin(yaw)
        p_x, p_y = gradient(surface, x, y)
        s, t_left = p_x * cos + p_y * sin, p_y * cos - p_x * sin
        ahead, both = 1.0 + s * s, 1.0 + s * s + t_left * t_left
        forward = v_x / np.sqrt(ahead) - v_y * s * t_left / np.sqrt(ahead * both)
        left = v_y * np.sqrt(ahead / both)
        x_rate, y_rate = cos * forward - sin * left, sin * forward + cos * left
        tiny = 1e-5
        after = gradient(surface, x + tiny * x_rate, y + tiny * y_rate)
        before = gradient(surface, x - tiny * x_rate, y - tiny * y_rate)
        steeper = ((after[0] - before[0]) * cos + (after[1] - before[1]) * sin) / (2.0 * tiny)
        yaw_rate = w * ahead / np.sqrt(both) - steeper * t_left / both
        return [x_rate, y_rate, yaw_rate, p_x * x_rate + p_y * y_rate]

    exact = solve_ivp(rates, (0.0, 30.0), np.zeros(4), rtol=1e-9, atol=1e-10, max_step=0.05)
    found = on_surface(motion, surface, ())
    np.testing.assert_allclose(found.poses[-1], exact.y[:3, -1], atol=2e-5)
    assert found.heights[-1] == pytest.approx(exact.y[3, -1], abs=2e-5)
    # The curvature does count: the planar heading is another.
    assert abs(found.poses[-1, 2] - motion.poses[-1, 2]) > 1e-3


def test_the_vehicle_stays_on_the_ground() -> None:
    motion, surface = varied(), surface_of(ROUGH, 3)
    ridden = on_surface(motion, surface, ())
    ground = np.array([height(surface, x, y) for x, y, _ in ridden.poses])
    np.testing.assert_allclose(ridden.heights, ground - ground[0], atol=1e-5)
    # Its z axis is the normal.
    rotations = Rotation.from_euler("ZYX", ridden.attitudes_at(sample_times(30.0, 10.0))[:, ::-1])
    at = ridden.poses_at(sample_times(30.0, 10.0))
    slopes = np.array([gradient(surface, x, y) for x, y, _ in at])
    normals = np.column_stack([-slopes, np.ones(len(slopes))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    np.testing.assert_allclose(rotations.apply([0.0, 0.0, 1.0]), normals, atol=1e-9)


def test_the_gyro_integrates_to_the_true_attitude() -> None:
    result = run(ROUGH, duration=60.0)
    times = sample_times(60.0, 100.0)
    rates = result.log.imu.angular_velocity @ ALPHA.imu_rotation.T
    attitudes = result.motion.attitudes_at(times)
    assert np.ptp(attitudes[:, :2], axis=0).min() > 0.1
    attitude = Rotation.from_euler("ZYX", attitudes[0, ::-1])
    for rate in 0.5 * (rates[1:] + rates[:-1]):
        attitude = attitude * Rotation.from_rotvec(0.01 * rate)
    left = (Rotation.from_euler("ZYX", attitudes[-1, ::-1]).inv() * attitude).magnitude()
    assert left < 1e-3
    # Without roll and pitch rates it would not.
    flat = Rotation.from_euler("ZYX", attitudes[0, ::-1])
    flat = flat * Rotation.from_rotvec([0.0, 0.0, 0.01 * rates[:, 2].sum()])
    assert (Rotation.from_euler("ZYX", attitudes[-1, ::-1]).inv() * flat).magnitude() > 0.03


def test_the_accelerometer_reads_the_acceleration_of_its_place_less_gravity() -> None:
    ridden = on_surface(varied(), surface_of(ROUGH, 5), ())
    place, times, step = np.array([0.3, -0.2, 0.5]), np.arange(1.0, 29.0, 0.1), 0.01

    def position(at: np.ndarray) -> np.ndarray:
        grid = np.arange(len(ridden.poses)) * STEP
        z = np.interp(at, grid, ridden.heights)
        origin = np.column_stack([ridden.poses_at(at)[:, :2], z])
        rotations = Rotation.from_euler("ZYX", ridden.attitudes_at(at)[:, ::-1])
        return origin + rotations.apply(place)

    world = (position(times + step) - 2.0 * position(times) + position(times - step)) / step**2
    rotations = Rotation.from_euler("ZYX", ridden.attitudes_at(times)[:, ::-1])
    expected = rotations.inv().apply(world + np.array([0.0, 0.0, GRAVITY]))
    found = specific_forces(ridden, times, 0.01, (0.3, -0.2, 0.5))
    assert np.sqrt(np.mean((found - expected) ** 2)) < 5e-3
    assert np.abs(found - [0.0, 0.0, GRAVITY]).max() > 1.0


@pytest.mark.parametrize("uphill", [0.0, 90.0])
def test_a_plane_moves_the_vehicle_as_the_same_slope_of_a_patch_does(uphill: float) -> None:
    terrain, patch = (kind(slope_deg=4.0, uphill_deg=uphill) for kind in (Terrain, Patch))
    plane = run(terrain, trajectory="figure-eight").motion
    planar = run(Terrain(), patches=(patch,), trajectory="figure-eight").motion
    np.testing.assert_allclose(plane.twists, planar.twists, atol=1e-7)
    np.testing.assert_allclose(plane.gravity, planar.gravity, atol=1e-7)
    times = sample_times(20.0, 100.0)
    place = (0.1, 0.2, 0.3)
    np.testing.assert_allclose(
        specific_forces(plane, times, 0.01, place),
        specific_forces(planar, times, 0.01, place),
        atol=1e-5,
    )
    np.testing.assert_allclose(
        angular_velocities(plane, times, 0.01), angular_velocities(planar, times, 0.01), atol=1e-7
    )
    # Seen from above, the plane is shorter uphill by the cosine of its slope, and headings lean.
    shorter = np.ones(2)
    shorter[int(uphill == 90.0)] = np.cos(np.radians(4.0))
    np.testing.assert_allclose(plane.poses[:, :2], planar.poses[:, :2] * shorter, atol=1e-6)
    yaw = planar.poses[:, 2]
    heading = np.arctan2(np.sin(yaw) * shorter[1], np.cos(yaw) * shorter[0])
    np.testing.assert_allclose(wrap_angle(plane.poses[:, 2] - heading), 0.0, atol=1e-7)
    assert np.abs(wrap_angle(plane.poses[:, 2] - yaw)).max() > 1e-3


def test_a_patch_of_a_slope_lies_over_the_terrain() -> None:
    hill = Patch(slope_deg=5.0, uphill_deg=90.0)
    over = run(ROUGH, patches=(hill,)).motion
    alone = run(Terrain(slope_deg=5.0, uphill_deg=90.0)).motion
    np.testing.assert_allclose(over.poses, alone.poses, atol=1e-9)
    # Where it ends, the ground around it goes on.
    half = run(ROUGH, patches=(msgspec.structs.replace(hill, time=(-1.0, 10.0)),)).motion
    np.testing.assert_allclose(half.gravity[:1900], over.gravity[:1900], atol=1e-9)
    assert np.abs(half.gravity[-1] - over.gravity[-1]).max() > 0.1
    np.testing.assert_allclose(np.linalg.norm(half.gravity, axis=1), GRAVITY, rtol=1e-12)


def test_a_kerb_pitches_the_vehicle_up_for_about_its_length() -> None:
    terrain = Terrain(kerb_height=0.08, kerb_every=6.0)
    motion = run(terrain, trajectory="straight", duration=25.0).motion
    pitch = motion.attitudes_at(np.arange(len(motion.poses)) / motion.rate)[:, 1]
    heights = motion.heights
    assert np.ptp(heights) == pytest.approx(0.08, abs=1e-4)
    # Nose up is a negative pitch, as in tf.
    steepest = np.degrees(np.arctan(2.0 * 0.08 / LENGTH))
    assert np.degrees(np.abs(pitch)).max() == pytest.approx(steepest, rel=0.01)
    climbing = np.abs(pitch) > 1e-4
    crossings = np.count_nonzero(np.diff(climbing.astype(int)) == 1)
    travelled = np.abs(np.diff(motion.poses[:, 0]))
    assert crossings >= 2
    # The last of them may not be finished.
    assert travelled[climbing[1:]].sum() / LENGTH == pytest.approx(crossings, abs=1.0)
    rising = np.diff(heights) > 1e-6
    assert (pitch[1:][rising] < 0.0).all()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"slope_deg": -1.0}, "slope_deg of the terrain must be between 0 and 60 degrees"),
        ({"rolling_deg": 31.0}, "rolling_deg of the terrain must be between 0 and 30 degrees"),
        ({"kerb_every": 0.0}, "kerb_every of the terrain must be a positive"),
        ({"slope_deg": "steep"}, "slope_deg of a Terrain: Expected `float`, got `str`"),
        ({"kerb_height": 0.5}, "kerb_height of the terrain must be at most 0.231 m"),
        ({"rolling_deg": 20.0, "wavelength": 0.5}, "wavelength of the terrain must be at least"),
        ({"kerb_height": 0.1, "kerb_every": 0.5}, "kerb_every of the terrain must be at least"),
        ({"slope_deg": 25.0, "uphill_deg": 90.0}, "the vehicle tips over"),
    ],
)
def test_terrain_that_is_invalid_or_too_rough_is_refused(values, message):
    with pytest.raises(SimulationError, match=message):
        run(Terrain(**values), duration=4.0)
