"""Bodies: sensors, actuators, and the limits that every command passes through."""

from neurorobo.bodies.body import Actuator, Array, Body, BodyConfig, Sensor
from neurorobo.bodies.supervisor import Supervisor

__all__ = ["Actuator", "Array", "Body", "BodyConfig", "Sensor", "Supervisor"]
