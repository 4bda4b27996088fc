"""Clients that others wrote, the manufacturer's among them, drive the emulators; they are in the extra `peers`."""

import sys
import time
import warnings
from typing import Any

import pytest
from stage_hardware.emulators.shot import ShotEmulator
from stage_hardware.emulators.sigma_koki import Speeds
from stage_hardware.emulators.wire import PseudoTerminal

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals"),
    pytest.mark.filterwarnings("ignore"),  # of what others wrote
]


def peer(name: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pytest.importorskip(name)


def emulated(model: str, acknowledges: bool | None = None, **settings: Any) -> ShotEmulator:
    emulator = ShotEmulator(model, acknowledges=acknowledges, **settings)
    emulator.origin_speeds = Speeds(5000, 20_000, 10)
    return emulator


def settings_of(emulator: ShotEmulator) -> tuple[int, bool]:
    assert isinstance(emulator.wire, PseudoTerminal)
    return emulator.wire.settings


@pytest.mark.parametrize(
    ("model", "name", "baud"),
    [("SHOT-302GS", "SHOT_302GS", 9600), ("SHOT-304GS", "SHOT_304GS", 9600), ("SHOT-702", "SHOT_702", 38400)],
)
@pytest.mark.parametrize("acknowledges", [True, False])
def test_pyoptosigma(model: str, name: str, baud: int, acknowledges: bool) -> None:
    module = peer("pyOptoSigma")
    with emulated(model, acknowledges) as emulator:
        session = module.Session(module.Controllers[name], wait_time=0.01)
        session.controller.comm_ack = module.Comm_ack.MAIN if acknowledges else module.Comm_ack.SUB
        for _ in emulator.axes:
            session.append_stage(module.Stages.SGSP26_100)  # 4 um in a full step, 2 in one of two
        session.connect(emulator.url)
        assert settings_of(emulator) == (baud, True)
        session.initialize()
        assert session.get_status() == ([0] * len(emulator.axes), "K", "K", "R")
        session.set_speed(1, 5000, 20_000, 10)
        session.get_position()  # it cannot move before it has asked for divisions
        assert emulator.speeds[0] == Speeds(5000, 20_000, 10)
        session.move(amount=500, in_pulse=True)
        session.move(amount=-380, in_pulse=True)
        session.move(
            amount=240, in_pulse=True, absolute=True
        )  # it cannot read negative counts: the sign is too far off
        assert session.get_position(in_pulse=True)[0] == 240 == emulator.axes[0].position
        assert session.get_position()[0] == 480
        session.move(amount=[100] * len(emulator.axes), in_pulse=True, absolute=True)
        assert session.get_position(in_pulse=True) == [100] * len(emulator.axes)
        session.set_division(2, 20)
        assert session.divisions[:2] == [2, 20]
        session.jog(1, 1)
        assert session.is_busy()
        session.abort()
        assert session.is_ready()
        session.set_origin(all_stages=True)
        assert session.get_position(in_pulse=True) == [0] * len(emulator.axes)
        session.set_excitation_mode(1, module.Excitation.Free)
        if acknowledges:
            with pytest.raises(module.Bad_Command_Parameter_or_Timing):
                session.reset(1, mechanical=True)
        else:
            session.reset(1, mechanical=True)
            assert session.get_status()[1] == "X"
        session.port.close()


def test_pyoptosigma_turns_a_table() -> None:
    module = peer("pyOptoSigma")
    with emulated("SHOT-302GS", positions=[0, 0]) as emulator:
        session = module.Session(module.Controllers.SHOT_302GS, wait_time=0.01)
        session.append_stage(module.Stages.SGSP_40YAW)
        session.connect(emulator.url)
        session.get_position()
        session.move(amount=1000)
        assert "M:1+P400" in emulator.heard and session.get_position() == [1000]
        session.port.close()


def wait(controller: Any) -> None:
    deadline = time.monotonic() + 5
    while controller.getACK3() != "R":
        assert time.monotonic() < deadline
        time.sleep(0.01)


@pytest.mark.parametrize(("model", "name", "baud"), [("SHOT-702", "SHOT702", 38400), ("GSC-02", "GSC02", 9600)])
def test_pysigmakoki(model: str, name: str, baud: int) -> None:
    module = peer("sigma_koki")
    with emulated(model) as emulator:
        controller = getattr(module, name)()
        controller.open(emulator.url)
        assert settings_of(emulator) == (baud, True)
        assert controller.getVersion() == "V1.00"
        speeds = (5000, 20_000, 10, 100, 1000, 50)
        controller.setSpeed(*((True, *speeds) if model == "GSC-02" else speeds))
        controller.returnToMechanicalOrigin(*("+-" if model == "GSC-02" else (True, True)))
        wait(controller)
        assert emulator.speeds == [Speeds(5000, 20_000, 10), Speeds(100, 1000, 50)]
        assert controller.getStatus() == "         0,         0,K,K,R"
        controller.move(300, -50)
        assert controller.getACK3() == "B"
        wait(controller)
        assert controller.getStatus() == "       300,-       50,K,K,R"
        controller.jog("+", "")
        controller.stop()
        assert controller.getACK3() == "R"
        controller.initializeOrigin(True, True)
        assert controller.getStatus() == "         0,         0,K,K,R"
        if model == "SHOT-702":
            controller.move_absolute(10, 10)
            wait(controller)
            assert controller.getStatus() == "        10,        10,K,K,R"
        controller.close()


@pytest.mark.parametrize(
    ("model", "name", "axes"), [("SHOT-302GS", "SHOT-702 / SHOT-302GS", 2), ("SHOT-304GS", "SHOT-304GS", 4)]
)
def test_the_manufacturers_own_client(model: str, name: str, axes: int) -> None:
    module = peer("SigmaKokiPy.SK_SHOT")
    with emulated(model) as emulator:
        controller = module.StageControlShot(emulator.url, name, 9600)

        def rest() -> list[int]:
            for _ in range(20):
                assert controller.UpdateStatus(), controller.LastErrorMessage
                if not controller.IsBusy:
                    return [controller.GetPositionPulse(number) for number in range(1, axes + 1)]
            raise AssertionError("it does not come to rest")

        assert controller.ReturnMechanicalOriginAll()
        assert rest() == [0] * axes
        assert controller.SetSpeedSinglePulse(1, 2000, 10)
        assert emulator.speeds[0] == Speeds(1000, 2000, 10)
        for number in range(1, axes + 1):
            controller.SetStrokeLimitMaxPulse(number, 10_000)
            controller.SetStrokeLimitMinPulse(number, -10_000)
        assert controller.AbsoluteDriveSinglePulse(2, -150)
        assert rest()[1] == -150 == emulator.axes[1].position
        assert controller.AbsoluteDriveSinglePulse(1, 9000)
        assert controller.PositioningStatus() and controller.IsBusy
        assert controller.EmergencyStop()
        assert controller.PositioningStatus() and not controller.IsBusy
        assert 0 < rest()[0] < 9000
        emulator.axes[1].lower_switch = -200
        assert controller.AbsoluteDriveSinglePulse(2, -400)
        assert rest()[1] == -200 and emulator.heard[-1] == "Q:"
        controller.CloseSerialPort()
