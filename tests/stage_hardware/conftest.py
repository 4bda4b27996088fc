"""What all tests of stages share."""

import importlib
from types import SimpleNamespace

import pytest


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Spare each test the 0.3 s that pyserial waits when it closes a TCP connection."""
    protocol = importlib.import_module("serial.urlhandler.protocol_socket")
    monkeypatch.setattr(protocol, "time", SimpleNamespace(sleep=lambda _: None))
