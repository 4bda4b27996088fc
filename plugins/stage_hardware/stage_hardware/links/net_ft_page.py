"""The page of a Net F/T box that tells how its counts are to be read.

Source: ATI, Net F/T manual 9620-05, on `netftapi2.xml`. Unverified on a device: that ``cfgmr`` and ``setbias`` are
there.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from http.client import HTTPConnection, HTTPException
from xml.etree import ElementTree

from stage_hardware import force_units
from stage_hardware.errors import HardwareError, LinkError, ReplyError

LONGEST_PAGE = 2**20


@dataclass(frozen=True)
class NetFtSettings:
    """How a box is set up.

    ``ranges`` are the largest forces (mN) and torques (mN*m), ``has_bias`` whether the box subtracts a bias of its own;
    both are unknown, None and False, to a page that does not tell. ``rate_Hz`` and ``is_enabled`` are those of RDT.
    """

    product: str
    mN_per_count: float
    mNm_per_count: float
    ranges: tuple[float, ...] | None
    rate_Hz: float | None
    is_enabled: bool
    has_bias: bool

    @property
    def is_axia(self) -> bool:
        """Whether it is a sensor of the Axia family, whose status words are others."""
        return "axia" in self.product.lower()


def read_settings(device: str, host: str, port: int, timeout_s: float) -> NetFtSettings:
    """Return the settings of the active configuration; a HardwareError if the page does not come or makes no sense."""
    page = _page(device, host, port, timeout_s, "/netftapi2.xml")
    if page.get("setcfgsel", "").isdigit():
        page = _page(device, host, port, timeout_s, f"/netftapi2.xml?index={page['setcfgsel']}")
    try:
        return settings(page)
    except KeyError as error:
        raise _nonsense(device, host, f"has no {error.args[0]}") from None
    except ValueError as error:
        raise _nonsense(device, host, f"cannot be read ({error})") from None


def settings(page: Mapping[str, str]) -> NetFtSettings:
    """Return what the elements of a page say; a KeyError or a ValueError if they do not."""
    force, torque = force_units.force_mN(page["scfgfu"]), force_units.torque_mNm(page["scfgtu"])
    per_force, per_torque = float(page["cfgcpf"]), float(page["cfgcpt"])
    if not (per_force > 0 and per_torque > 0):
        raise ValueError(f"{per_force:g} and {per_torque:g} counts per unit")
    ranges = _numbers(page.get("cfgmr", ""))
    return NetFtSettings(
        page["prodname"],
        force / per_force,
        torque / per_torque,
        tuple(largest * unit for largest, unit in zip(ranges, (force,) * 3 + (torque,) * 3, strict=True))
        if ranges
        else None,
        float(page["comrdtrate"]) if "comrdtrate" in page else None,
        page.get("comrdte", "Enabled").lower() != "disabled",
        any(_numbers(page.get("setbias", ""))),
    )


def _numbers(text: str) -> list[float]:
    return [float(number) for number in re.split(r"[;,\s]+", text) if number]


def _page(device: str, host: str, port: int, timeout_s: float, path: str) -> dict[str, str]:
    connection = HTTPConnection(host, port, timeout=timeout_s)  # directly: no proxy leads to a box
    try:
        connection.request("GET", path)
        reply = connection.getresponse()
        text = reply.read(LONGEST_PAGE)
    except (OSError, HTTPException) as error:
        raise LinkError(
            device,
            f"http://{host}:{port}{path} cannot be read ({error or type(error).__name__})",
            "see to power, network and address",
        ) from error
    finally:
        connection.close()
    if reply.status != 200:
        raise _nonsense(device, host, f"is answered with status {reply.status}")
    try:
        elements = ElementTree.fromstring(text).iter()
    except ElementTree.ParseError as error:
        raise _nonsense(device, host, f"is no XML ({error})") from None
    return {element.tag.rpartition("}")[2]: (element.text or "").strip() for element in elements}


def _nonsense(device: str, host: str, fault: str) -> HardwareError:
    return ReplyError(device, f"the page netftapi2.xml of {host} {fault}", "see that a Net F/T box has this address")
