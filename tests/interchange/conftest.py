"""Without the extra `nir` there is nothing to exchange; `make test` installs it."""

import pytest

pytest.importorskip("nir")
