"""Classic experiments on learning brains, as bodies and tasks of neurorobo."""

__version__ = "0.1.0"
