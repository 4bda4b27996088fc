"""Making Gymnasium environments, and what they observe and do as vectors of numbers; imports Gymnasium when called."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from neurorobo.bodies.body import Array
from neurorobo.errors import NeuroroboError

if TYPE_CHECKING:
    from gymnasium import Env
    from gymnasium.spaces import Box

Bounds = tuple[Array, Array]

MUJOCO = ("mujoco", "glfw", "imageio")
"""The packages that Gymnasium's environments of MuJoCo import."""


@dataclass(frozen=True)
class Spaces:
    """The least and the largest of each element that an environment observes and is told, and how long its steps are.

    Discrete actions have an element each, without bounds: how much it is preferred. ``period_ns`` is the environment's
    ``dt``, nothing if it does not say.
    """

    observation: Bounds
    action: Bounds
    period_ns: int | None


def make(environment: str, kwargs: Mapping[str, Any]) -> "Env[Any, Any]":
    """Return the environment; a NeuroroboError with the cure if it cannot be made, whatever it raised."""
    import gymnasium

    try:
        return gymnasium.make(environment, disable_env_checker=True, **kwargs)
    except ImportError as error:
        extra = error.name is not None and error.name.partition(".")[0] in MUJOCO
        cure = "pip install 'neurorobo[mujoco]'" if extra else "install the package that provides it"
        raise NeuroroboError(f"the environment `{environment}` cannot be imported: {error}; {cure}") from error
    except Exception as error:
        raise NeuroroboError(f"the environment `{environment}` cannot be made: {error}") from error


@cache
def _spaces(environment: str, kwargs: str) -> Spaces:
    from gymnasium.spaces import Box, Discrete, flatten_space

    made = make(environment, json.loads(kwargs))
    try:
        observation, action = made.observation_space, made.action_space
        period_s = getattr(made.unwrapped, "dt", None)
    finally:
        made.close()
    if not observation.is_np_flattenable:
        raise NeuroroboError(f"`{environment}` observes {observation}, which has no fixed number of elements")
    flat = flatten_space(observation)
    assert isinstance(flat, Box)
    if isinstance(action, Box):
        commanded = _bounds(action)
    elif isinstance(action, Discrete):
        commanded = np.full(int(action.n), -np.inf), np.full(int(action.n), np.inf)
    else:
        raise NeuroroboError(f"`{environment}` takes actions of {action}; only Box and Discrete can be commanded")
    return Spaces(_bounds(flat), commanded, None if period_s is None else round(float(period_s) * 1e9))


def spaces(environment: str, kwargs: Mapping[str, Any]) -> Spaces:
    """Return the vectors of an environment, which is made to find out; a NeuroroboError if there are none."""
    try:
        key = json.dumps(kwargs, sort_keys=True)
    except TypeError as error:
        raise NeuroroboError(f"the kwargs of `{environment}` must be plain numbers, texts, lists: {error}") from error
    return _spaces(environment, key)


def to_vector(environment: "Env[Any, Any]", observation: object) -> Array:
    """Return what an environment observes as its elements."""
    from gymnasium.spaces import flatten

    return np.asarray(flatten(environment.observation_space, observation), dtype=np.float64)


def to_action(environment: "Env[Any, Any]", vector: Array) -> Any:
    """Return the action of these elements; of discrete ones the most preferred."""
    from gymnasium.spaces import Discrete

    space = environment.action_space
    if isinstance(space, Discrete):
        return int(space.start) + int(vector.argmax())
    return vector.reshape(space.shape).astype(space.dtype)


def _bounds(box: "Box") -> Bounds:
    return box.low.astype(np.float64).ravel(), box.high.astype(np.float64).ravel()
