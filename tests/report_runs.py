"""Runs for reports, and the parsed file of a report."""

import copy
import hashlib
import json
import re
import warnings
from base64 import b64encode
from html.parser import HTMLParser

import warpcontact as wc

CORNERS = [[x, y, z] for z in (-0.09, 0.09) for y in (-0.14, 0.14) for x in (-0.19, 0.19)]

# A crate falls onto its vertices; in environment 4 it exceeds the speed limit immediately.
CRATE = {
    "name": "crate",
    "envs": 6,
    "duration": 0.5,
    "dt": 5e-4,
    "seed": 2,
    "output": {"usd_envs": 0},
    "surface": [
        {
            "name": "ground",
            "mesh": {"shape": "grid", "size": [6.0, 6.0], "cells": [4, 4]},
            "color": [0.6, 0.6, 0.55],
        },
        {"name": "hull", "body": "crate", "mesh": {"shape": "box", "size": [0.4, 0.3, 0.2]}},
    ],
    "body": [
        {
            "name": "crate",
            "mass": 8.0,
            "inertia": [0.08667, 0.13333, 0.16667],
            "position": [0.0, 0.0, 0.4],
            "color": [0.85, 0.5, 0.2],
        }
    ],
    "points": [{"name": "corners", "body": "crate", "positions": CORNERS}],
    "material": [
        {
            "name": "wood",
            "law": {"type": "HuntCrossley", "stiffness": 1e5, "restitution": 0.4},
            "friction": {"type": "Tanh", "mu": 0.4, "velocity_scale": 0.05},
        }
    ],
    "contact": [{"name": "feet", "points": "corners", "surface": "ground", "material": "wood", "radius": 0.01}],
    "variation": {
        "crate.angular_velocity": {"uniform": [[-3, -3, -3], [3, 3, 3]]},
        "feet.friction.mu": {"uniform": [0.1, 0.8]},
        "scene.max_speed": {"values": [1e3, 1e3, 1e3, 1e3, 1.0, 1e3]},
    },
    "record": {
        "every": 5e-3,
        "sensors": [
            *(f"feet.{key}" for key in ("gap", "normal_force", "friction_force", "point", "normal", "status")),
            "scene.kinetic_energy",
        ],
    },
    "outcome": {
        "hardest": {"type": "Max", "of": "feet.normal_force", "items": "max"},
        "place": {"type": "Final", "of": "crate.position"},
    },
}


def changed(**changes):
    """Returns the experiment with changed entries; ``None`` removes one."""
    study = copy.deepcopy(CRATE) | copy.deepcopy(changes)
    return {key: value for key, value in study.items() if value is not None}


def run(folder, study=CRATE, **options):
    """Runs an experiment."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".* and are frozen", category=RuntimeWarning)
        return wc.Experiment.from_dict(study).run(folder, device="cpu", **options)


TAGS = """
    html head meta title link style body header main footer nav section h1 h2 h3 p div span a b bdi strong code pre
    ul li dl dt dd table thead tbody tr th td figure figcaption details summary dialog form label input select
    button output canvas noscript script svg g path line rect text clippath
"""


class ParsedPage(HTMLParser):
    """The elements of a page, and its texts without scripts and styles.

    Attributes:
        elements: Names and attributes, in order.
        text: The visible text.
        blocks: Content of the data blocks by their ids.
        scripts: The executable scripts.
        styles: The style sheets.
    """

    VOID = ("meta", "link", "input", "br")

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.elements, self.blocks, self.scripts, self.styles = [], {}, [], []
        self.text, self._open = "", []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        attributes = dict(attrs)
        assert len(attributes) == len(attrs), (tag, attrs)
        self.elements.append((tag, attributes))
        if tag not in self.VOID:
            self._open.append((tag, attributes))

    def handle_endtag(self, tag):
        assert self._open.pop()[0] == tag

    def handle_data(self, data):
        tag, attributes = self._open[-1] if self._open else ("", {})
        if tag == "script" and attributes.get("type") == "application/json":
            self.blocks[attributes["id"].removeprefix("data-")] = json.loads(data)
        elif tag == "script":
            self.scripts.append(data)
        elif tag == "style":
            self.styles.append(data)
        else:
            self.text += data

    def policy(self):
        """Returns the Content-Security-Policy as directives and their values."""
        content = next(
            attributes["content"]
            for tag, attributes in self.elements
            if tag == "meta" and attributes.get("http-equiv") == "Content-Security-Policy"
        )
        return dict(part.strip().partition(" ")[::2] for part in content.split(";"))


def check_harmless(text):
    """Checks that a page loads nothing and runs only its own script; returns it parsed."""
    page = ParsedPage(text)
    policy = page.policy()

    def hashed(content):
        return f"'sha256-{b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"

    assert policy["default-src"] == "'none'"
    assert len(page.scripts) == len(page.styles) == 1
    assert policy["script-src"] == hashed(page.scripts[0])
    assert policy["style-src"] == hashed(page.styles[0])
    assert policy["img-src"] == "data:"
    assert not re.search(r"unsafe|https?:|\*", " ".join(policy.values()))
    for tag, attributes in page.elements:
        assert tag in TAGS.split(), tag
        assert not any(
            key.startswith("on") or key in ("style", "src", "srcdoc", "xlink:href") for key in attributes
        )
        if "href" in attributes:
            assert attributes["href"].startswith("#") or attributes["href"] == "data:,"
    return page
