"""Tasks: a body, a goal, a reward and an end; and the same as Gymnasium environments (:mod:`neurorobo.tasks.env`)."""

from neurorobo.tasks.task import Task, TaskConfig

__all__ = ["Task", "TaskConfig"]
