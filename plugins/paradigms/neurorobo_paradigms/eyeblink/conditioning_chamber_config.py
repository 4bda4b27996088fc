"""The configuration of the chamber in which an eyelid is conditioned; imports no torch."""

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from neurorobo.bodies.body import Actuator, BodyConfig, Sensor
from neurorobo.units import Duration, Unit, format_duration

PositiveDuration = Annotated[Duration, Field(gt=0)]


class Stimuli(NamedTuple):
    """Which stimuli a trial has; they come when they would come in a trial that has both."""

    tone: bool
    puff: bool


class PhaseConfig(BaseModel):
    """Some trials of one kind, one after the other."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(pattern=r"^[A-Za-z]\w*$", description="What its figures are called by.")
    trials: int = Field(ge=1)
    stimuli: Literal["paired", "tone", "puff", "unpaired"] = Field(
        default="paired",
        description="`paired`: the puff comes at the end of the tone. `tone` and `puff`: one of them alone. "
        "`unpaired`: a trial with the tone alone and one with the puff alone, in turns.",
    )

    def stimuli_of(self, trial: int) -> Stimuli:
        """Return the stimuli of the trial with this number, from 0 on, within the phase."""
        if self.stimuli == "unpaired":
            return Stimuli(tone=trial % 2 == 0, puff=trial % 2 == 1)
        return Stimuli(tone=self.stimuli != "puff", puff=self.stimuli != "tone")


class ConditioningChamberConfig(BodyConfig):
    """An eye, its lid, a loudspeaker and a nozzle: delay conditioning, in which the tone lasts until the puff ends."""

    implementation: ClassVar[str] = "neurorobo_paradigms.eyeblink.conditioning_chamber:ConditioningChamber"

    type: Literal["paradigms.conditioning_chamber"] = "paradigms.conditioning_chamber"
    trial: PositiveDuration = Field(default=900_000_000, description="From the start of one trial to that of the next.")
    tone_onset: Duration = Field(default=100_000_000, description="When the tone comes, from the start of the trial.")
    interval: PositiveDuration = Field(
        default=300_000_000, description="From the onset of the tone to that of the puff (interstimulus interval)."
    )
    puff: PositiveDuration = Field(default=50_000_000, description="How long the puff lasts.")
    phases: tuple[PhaseConfig, ...] = Field(
        default=(PhaseConfig(name="acquisition", trials=100),), min_length=1, description="The trials, in order."
    )
    full_closure: Annotated[float, Unit("Hz", gt=0)] = Field(
        default=100.0, description="The firing rate that holds the eye just shut; more does not shut it further."
    )
    lid_time_constant: PositiveDuration = Field(
        default=30_000_000, description="Within which the lid comes within 1/e of where the firing rate holds it."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        end = self.tone_onset + self.interval + self.puff
        if end >= self.trial:
            raise ValueError(
                f"the puff ends {format_duration(end)} after the start of a trial of {format_duration(self.trial)}; "
                "let trials be longer"
            )
        names = [phase.name for phase in self.phases]
        if twice := [name for name in names if names.count(name) > 1]:
            raise ValueError(f"two phases are called `{twice[0]}`; call one otherwise")
        return self

    def schedule(self) -> Iterator[tuple[str, Stimuli]]:
        """Yield the phase and the stimuli of each trial, in order."""
        for phase in self.phases:
            for trial in range(phase.trials):
                yield phase.name, phase.stimuli_of(trial)

    def sensors(self) -> dict[str, Sensor]:
        """What is heard and felt."""
        return {
            "tone": Sensor("1", 1, 0.0, 1.0, 1.0, "Whether the tone sounds."),
            "puff": Sensor("1", 1, 0.0, 1.0, description="How much of the puff is felt, by what is open of the eye."),
            "closure": Sensor("1", 1, 0.0, 1.0, description="How far the eye is shut, 1 being wholly."),
        }

    def actuators(self) -> dict[str, Actuator]:
        """What shuts the eye."""
        return {"eyelid": Actuator("Hz", 1, 0.0, 1000.0, "hold", "Firing rate of each neuron that shuts the eye.")}
