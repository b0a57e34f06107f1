"""Reading and writing of ``mechanism.yaml``, which describes a mechanism.

Unknown keys are refused by name and line. URDFs beside the file define the joints of legs and
the points of the platform.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from pincal.errors import MechanismError, located
from pincal.files.text import plain_number
from pincal.files.urdf import leg_links, read_leg, read_points
from pincal.files.yaml import Entry, Readers, read_yaml
from pincal.model import Joint, Leg, Load, Mechanism, Platform, Sensor
from pincal.model.checks import LARGEST
from pincal.model.consistency import check_home
from pincal.model.joint import End
from pincal.model.placement import Coordinate
from pincal.model.platform import KINDS, TWIST
from pincal.model.terms import Cables, Harmonic, Power, Share, Term
from pincal.types import Quantity

FORMAT, YAML = 1, "mechanism.yaml"
#: Forms of terms by the key that names them, with the further keys of each form.
_FORMS: dict[str, tuple[Any, tuple[str, ...]]] = {
    "sine": (Harmonic, ("period",)),
    "cosine": (Harmonic, ("period",)),
    "power": (Power, ("range", "centre")),
    "per": (Share, ("reference",)),
}
_BLOCKS = ("parameters", "labels", "load")  # mappings written with one line per key


def _term(entry: Entry, amplitude: str, place: str) -> Term:
    """Read a term with the name of its amplitude; ``place`` is for messages."""
    numbers = dict.fromkeys((*_FORMS, "period", "range", "centre", "reference"), Entry.number)
    values = entry.values({**numbers, "of": Entry.text, "power": lambda part: part.value})
    influence = values.pop("of", "")
    forms = [key for key in _FORMS if key in values] or ["per"] * bool(influence)
    form, fault = " and ".join(forms) or "none", ""
    kind, further = _FORMS.get(form, (None, ()))
    odd = [key for key in values if key not in (form, *further)]
    if kind is None:
        fault = f"expected one of {', '.join(_FORMS)}, or 'of' alone; got {form}"
    elif odd:
        fault = f"{odd[0]!r} does not go with {form!r}; expected {', '.join(further)}"
    elif form == "power" and "range" not in values:
        fault = "'power' needs 'range' beside it"
    elif kind is Harmonic:
        values |= {"order": values.pop(form), "phase": form}
    with located(f"{place}, term {amplitude!r}", MechanismError):
        if fault:
            raise MechanismError(fault)
        return Term(amplitude, kind(**values), of=influence)


def _terms(entry: Entry, place: str) -> tuple[Term, ...]:
    return tuple(_term(part, amplitude, place) for amplitude, part in entry.pairs().items())


def _zero(entry: Entry) -> float | Literal["home"]:
    if entry.value == "home":
        return "home"
    if not abs(plain_number(str(entry.value))) <= LARGEST:
        entry.refuse("a finite number or 'home' is expected")
    return entry.number()


def _coordinates(entry: Entry | None, place: str) -> tuple[Coordinate, ...]:
    """Read the coordinates that place a joint; empty if its URDF alone places it."""
    coordinates = []
    for item in entry.items() if entry else ():
        if len(pairs := item.pairs()) != 1:
            item.refuse("a coordinate is expected, such as '- polar: [OA, beta]'")
        ((kind, values),) = pairs.items()
        parts = values.items() if isinstance(values.value, list) else [values]
        with located(place, MechanismError):
            coordinates.append(Coordinate(kind, tuple(map(Entry.name_or_number, parts))))
    return tuple(coordinates)


def _platform(entry: Entry) -> Platform:
    keys = entry.keys(("kind", "urdf", "home"))
    kind, twist = keys["kind"], list[str]()
    if isinstance(kind.value, dict):
        parts = kind.keys(("name", "freedoms"))
        kind, twist = parts["name"], [freedom.text() for freedom in parts["freedoms"].items()]
    home = keys["home"].mapped(Entry.number)
    platform = Platform(kind.text(), tuple(home.values()), tuple(twist))
    if tuple(home) != platform.coordinates:
        raise MechanismError(
            f"platform.home has {', '.join(home)}; expected {', '.join(platform.coordinates)}"
        )
    return platform


def _drawn(entry: Entry) -> tuple[tuple[str, float], ...]:
    return tuple(entry.mapped(Entry.number).items())


def read_mechanism(folder: Path) -> Mechanism:
    """Read a mechanism from a folder's ``mechanism.yaml`` and the URDFs that it names."""
    needed = ("pincal", "name", "platform", "legs")
    known = ("description", "labels", "load", "cables")
    keys = read_yaml(inside(folder, YAML), MechanismError).keys(needed, known)
    keys["pincal"].choice(FORMAT)
    platform = _platform(keys["platform"])
    points = read_points(inside(folder, keys["platform"].pairs()["urdf"].text()))
    legs = tuple(_leg(leg, folder, points) for leg in keys["legs"].items(least=1))
    mechanism = Mechanism(
        keys["name"].text(),
        platform,
        legs,
        keys["description"].text() if "description" in keys else "",
        tuple(keys["labels"].mapped(Entry.text).items()) if "labels" in keys else (),
        keys["load"].built(Load, drawn=_drawn) if "load" in keys else None,
        keys["cables"].built(Cables) if "cables" in keys else None,
    )
    identified = (folder.parent / "result.json").is_file()  # its home is the nominal one
    for leg in () if identified else legs:
        check_home(leg, platform)
    return mechanism


def _check_joints(
    leg: str, named: Iterable[str], home: Mapping[str, float], joints: Sequence[Joint], urdf: str
) -> None:
    """Raise if a leg names joints that its URDF does not have, or misses a home position."""
    known = [joint.name for joint in joints]
    for name in named:
        if name not in known:
            raise MechanismError(
                f"{leg}: unknown joint {name!r}; {urdf} has {', '.join(known[:-1])}, the platform "
                f"point is {known[-1]!r}"
            )
    moving = [j.name for j in joints if j.kind != "fixed" and j.follows is None]
    if set(home) != set(moving):
        raise MechanismError(
            f"{leg}: 'home' gives {', '.join(home) or 'nothing'}; it needs the home position of "
            f"each moving joint: {', '.join(moving)}"
        )


def _leg(entry: Entry, folder: Path, points: Mapping[str, Joint]) -> Leg:
    """Read a leg from its keys and its URDF."""
    needed = ("name", "urdf", "tip", "platform_point", "home", "sensors", "parameters")
    keys = entry.keys((*needed, "placements"), ("closes", "terms", "ends", "ratios"))
    name = keys["name"].name()
    point, placements = points[keys["platform_point"].choice(*points)], keys["placements"].pairs()
    home = keys["home"].mapped(Entry.number)
    for parameter, part in keys["parameters"].pairs().items():
        if not parameter.isidentifier():
            part.refuse("a parameter's name is letters, digits and _")
    of_parameters = keys["terms"].pairs() if "terms" in keys else {}
    ratios = keys["ratios"].mapped(Entry.text) if "ratios" in keys else {}
    read: Any = {"zero": _zero, "terms": lambda part: _terms(part, name)}
    read["form"] = lambda part: part.choice("joint", "reading")
    read["direction"] = lambda part: part.choice(1, -1)
    sensors = tuple(item.built(Sensor, "joint", **read) for item in keys["sensors"].items())
    ends = tuple(_end(item, points) for item in keys["ends"].items()) if "ends" in keys else ()
    path = inside(folder, keys["urdf"].text())
    joints, ends = read_leg(path, keys["tip"].text(), ends)
    met = [end.point for end in ends if end.point is not None]
    named = (*placements, *home, *ratios, *(sensor.joint for sensor in sensors))
    _check_joints(name, named, home, (*joints, *met, point), path.name)

    def placed(joint: Joint) -> Joint:
        place = f"{name}, placement of {joint.name!r}"
        coordinates = _coordinates(placements.get(joint.name), place)
        placement = replace(joint.placement, coordinates=coordinates)
        at_home = home.get(joint.name, 0.0)
        return replace(joint, placement=placement, home=at_home, ratio=ratios.get(joint.name, ""))

    return Leg(
        name=name,
        joints=tuple(map(placed, joints)),
        sensors=sensors,
        parameters=_drawn(keys["parameters"]),
        point=placed(point),
        closes=keys["closes"].choice("point", "frame") if "closes" in keys else "point",
        terms=tuple(
            (parameter, term)
            for parameter, part in of_parameters.items()
            for term in _terms(part, f"{name}, parameter {parameter!r}")
        ),
        ends=tuple(end.moved(placed) for end in ends),
    )


def _end(entry: Entry, points: Mapping[str, Joint]) -> End:
    """Read a further end of a leg, which names links of its URDF."""
    readers: Readers = {
        "tip": Entry.text,
        "platform_point": lambda part: points[part.choice(*points)],
        "meets": Entry.text,
        "closes": lambda part: (
            tuple(row.choice(*TWIST) for row in part.items(least=1))
            if isinstance(part.value, list)
            else part.choice("point", "frame")
        ),
    }
    values = entry.values(readers, ("tip",))
    if ("meets" in values) == ("platform_point" in values):
        entry.fail("an end needs either 'platform_point' or, for a loop within the leg, 'meets'")
    meets = values.get("platform_point") or values["meets"]
    return End(values["tip"], meets, values.get("closes", "point"))


def inside(folder: Path, name: str) -> Path:
    """Return the path of a file in a mechanism's folder; paths that lead out are refused."""
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise MechanismError(f"{name!r} cannot be a file's name: {error}") from error
    if not inside:
        raise MechanismError(f"{name!r} leads out of the mechanism's folder; keep its files inside")
    return folder / name


def mechanism_yaml(mechanism: Mechanism) -> str:
    """Return the text of a mechanism's ``mechanism.yaml``."""
    platform, load = mechanism.platform, mechanism.load
    weight = load and vars(load) | {"drawn": dict(load.drawn), "assumed": load.assumed or None}
    kind: Any = platform.kind
    if kind not in KINDS:
        kind = {"name": platform.kind, "freedoms": platform.twist}
    home = dict(zip(platform.coordinates, platform.home, strict=True))
    keys = {
        "pincal": FORMAT,
        "name": mechanism.name,
        "description": mechanism.description,
        "platform": {"kind": kind, "urdf": "platform.urdf", "home": home},
        "legs": [_described_leg(leg) for leg in mechanism.legs],
        "labels": dict(mechanism.labels),
        "load": weight and _filled(weight),
        "cables": None if mechanism.cables is None else vars(mechanism.cables),
    }
    header = "# A mechanism of pincal. Lengths in m, angles in rad. See docs/mechanism_files.md\n"
    return header + yaml.dump(_filled(keys), Dumper=_Dumper, sort_keys=False, width=100)


def _described_leg(leg: Leg) -> dict[str, Any]:
    """Return the keys of a leg for ``mechanism.yaml``."""
    of_parameters = {
        name: _described_terms((term for owner, term in leg.terms if owner == name), leg.name)
        for name in leg.deformed
    }
    links = leg_links(leg)
    return {
        "name": leg.name,
        "urdf": f"{leg.name}.urdf",
        "tip": links[-1],
        "platform_point": leg.point.name,
        **({} if leg.closes == "point" else {"closes": leg.closes}),
        **({"ends": [_described_end(end, leg, links) for end in leg.ends]} if leg.ends else {}),
        "home": leg.homes,
        "sensors": [
            _filled(vars(sensor) | {"terms": _described_terms(sensor.terms, leg.name)})
            for sensor in leg.sensors
        ],
        "parameters": dict(leg.parameters),
        "placements": {
            joint.name: [
                {c.kind: c.values[0] if len(c.values) == 1 else c.values}
                for c in joint.placement.coordinates
            ]
            for joint in (*leg.joints, *leg.points)
            if joint.placement.coordinates
        },
        **_filled(
            {
                "ratios": {joint.name: joint.ratio for joint in leg.joints if joint.ratio},
                "terms": of_parameters,
            }
        ),
    }


def _described_end(end: End, leg: Leg, links: list[str]) -> dict[str, Any]:
    if isinstance(end.meets, str):
        met = {"meets": links[leg.index(end.meets) + 1]}
    else:
        met = {"platform_point": end.meets.name}
    closes = end.closes if isinstance(end.closes, str) else list(end.closes)
    return {"tip": links[leg.index(end.tip) + 1], **met, "closes": closes}


def _filled(keys: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in keys.items() if value not in (None, "", {})}


def _described_terms(terms: Iterable[Term], place: str) -> dict[str, Any]:
    """Return the keys of terms by their amplitudes, as ``_terms`` reads them."""
    described = {}
    for term in terms:
        if not term.has_form:
            raise MechanismError(
                f"{place}: the term of {term.parameter!r} is code, which a mechanism's folder "
                "cannot hold; save the mechanism without terms, and its parameters "
                "(mechanism.parameters) apart"
            )
        basis: Any = term.basis
        keys = {
            field.name: value
            for field in fields(basis)
            if (value := getattr(basis, field.name)) != field.default
        }
        if isinstance(basis, Harmonic):
            keys = {keys.pop("phase"): keys.pop("order")} | keys
        elif isinstance(basis, Share) and not term.of:
            keys = {"per": basis.per} | keys
        described[term.parameter] = {"of": term.of} | keys if term.of else keys
    return described


class _Dumper(yaml.CSafeDumper):
    """Dumper that writes innermost mappings on one line, and NumPy's numbers as Python's."""

    def ignore_aliases(self, data: object) -> bool:  # noqa: ARG002 - all is written out
        return True

    def represent_mapping(self, tag: str, mapping: Any, flow_style: Any = None) -> yaml.MappingNode:
        node = super().represent_mapping(tag, mapping, flow_style)
        node.flow_style = all(
            isinstance(part, yaml.ScalarNode)
            for _, value in node.value
            for part in (value.value if isinstance(value, yaml.SequenceNode) else [value])
        )
        for key, value in node.value:
            if key.value in _BLOCKS:
                value.flow_style = False
        return node


for _number in (np.floating, np.integer):
    _Dumper.add_multi_representer(_number, lambda dumper, n: dumper.represent_data(n.item()))
_Dumper.add_multi_representer(Quantity, yaml.CSafeDumper.represent_float)
