"""The contact along the way of an emulated rig: the same law as the simulation's, drawn once for each depth."""

import math
from collections.abc import Iterator

import numpy as np
import pytest
from precision_interaction.rig.contact_path import ContactPath
from precision_interaction.rig.contact_path_config import ContactPathConfig
from precision_interaction.rig.insertion_rig import InsertionRig
from precision_interaction.rig.insertion_rig_config import InsertionRigConfig

GAP_UM = 80.0
MS = 1_000_000
INSERTIONS = 400


class Bench:
    """A contact path with a clock that is set by hand."""

    def __init__(self, seed: int = 0, law: str = "measured", **body: object) -> None:
        self.ns = 0
        rig = InsertionRigConfig.model_validate({"contact": {"law": law}, "gap": f"{GAP_UM} um", **body})
        config = ContactPathConfig(axes=("z", "x", "y"), body=rig, seed=seed)
        self.path = ContactPath(config, clock=lambda: self.ns)

    def at(self, depth_um: float, x_um: float = 0.0, y_um: float = 0.0) -> tuple[float, float]:
        self.ns += MS
        x_mN, y_mN, *_ = self.path.wrench({"z": GAP_UM + depth_um, "x": x_um, "y": y_um})
        return x_mN, y_mN

    def move(self, start_um: float, end_um: float, samples: int) -> tuple[float, float]:
        """Go from one depth to another evenly, and stand still for a while."""
        force = (0.0, 0.0)
        for depth_um in np.linspace(start_um, end_um, samples + 1)[1:]:
            force = self.at(float(depth_um))
        self.ns += 50 * MS
        self.at(end_um)
        return force

    def out(self) -> None:
        self.at(-10.0)
        self.ns += 50 * MS


def simulated(law: str, moves_um: tuple[float, ...]) -> np.ndarray:
    """Return the radial forces (insertions, 2) after these moves in the simulated rig, from just before contact."""
    rig = InsertionRig(InsertionRigConfig.model_validate({"contact": {"law": law}, "gap": f"{GAP_UM} um"}))
    rig.reset(range(5000, 5000 + INSERTIONS))
    for speed_um_s in (GAP_UM, *moves_um):
        rig.advance({"axial_speed": np.full((INSERTIONS, 1), speed_um_s)}, 1_000_000_000)
    return rig.force_mN[:, :2]


@pytest.mark.parametrize("law", ["measured", "proportional"])
@pytest.mark.parametrize("moves_um", [(30.0,), (100.0,), (30.0, 90.0, 60.0)])
@pytest.mark.parametrize("samples", [1, 40])
def test_forces_are_distributed_as_in_the_simulation(law: str, moves_um: tuple[float, ...], samples: int) -> None:
    bench = Bench(seed=11, law=law)

    def insertions() -> Iterator[tuple[float, float]]:
        for _ in range(INSERTIONS):
            bench.out()
            bench.move(-10.0, 0.0, 5)
            depth_um, force = 0.0, (0.0, 0.0)
            for move_um in moves_um:
                force = bench.move(depth_um, depth_um + move_um, samples)
                depth_um += move_um
            yield force

    felt, expected = np.array(list(insertions())), simulated(law, moves_um)
    error = np.sqrt((felt.var(0) + expected.var(0)) / INSERTIONS)
    assert (np.abs(felt.mean(0) - expected.mean(0)) < 4 * error).all()
    # The ratio of two variances of normal samples strays by 2 / sqrt(n) or so.
    assert (np.abs(np.log(felt.var(0) / expected.var(0))) < 4 * 2 / math.sqrt(INSERTIONS)).all()


def test_a_way_back_retraces_and_what_was_felt_is_felt_again() -> None:
    bench = Bench()
    depths = np.linspace(0.5, 120.0, 240)
    there = [bench.at(float(depth)) for depth in depths]
    bench.ns += 50 * MS
    back = [bench.at(float(depth)) for depth in depths[::-1]]
    bench.ns += 50 * MS
    again = [bench.at(float(depth)) for depth in depths]
    np.testing.assert_allclose(back[::-1], there)
    np.testing.assert_allclose(again, there)


def test_out_of_the_hole_nothing_is_felt_and_the_next_insertion_is_another() -> None:
    bench = Bench()
    first = bench.move(0.0, 100.0, 20)
    assert bench.at(-1.0, x_um=20.0) == (0.0, 0.0)
    bench.ns += 50 * MS
    assert bench.move(0.0, 100.0, 20) != first
    assert Bench().move(0.0, 100.0, 20) == first  # the seed decides


def test_a_radial_way_takes_off_stiffness_times_its_length() -> None:
    bench = Bench(stiffness="80 mN/um")
    x_mN, y_mN = bench.move(0.0, 100.0, 20)
    assert bench.at(100.0, x_um=2.0, y_um=-1.0) == pytest.approx((x_mN - 160.0, y_mN + 80.0))
    assert bench.at(100.0) == pytest.approx((x_mN, y_mN))


def test_another_stiffness_holds_from_its_travel_on() -> None:
    bench = Bench(stiffness="80 mN/um", stiffness_change={"at": f"{GAP_UM + 50} um", "to": "40 mN/um"})
    x_mN, _ = bench.move(0.0, 100.0, 20)
    assert bench.at(100.0, x_um=2.0)[0] == pytest.approx(x_mN - 80.0)


def test_a_body_whose_contact_is_no_law_is_refused() -> None:
    with pytest.raises(ValueError, match=r"must be a `precision\.insertion_rig`"):
        ContactPathConfig.model_validate({"axes": ["z", "x", "y"], "body": {"type": "precision.mujoco_rig"}})
