"""What the engine's tests share: the path as a parameter."""

from collections.abc import Iterator

import pytest

from tests.engine.paths import engine, needs_native


@pytest.fixture(params=["portable", pytest.param("native", marks=needs_native())])
def path(request: pytest.FixtureRequest) -> Iterator[str]:
    with engine(request.param):
        yield request.param
