"""URDF files written for tests, and their forward kinematics as plain products of 4x4 matrices, read anew."""

import math
import xml.etree.ElementTree as ElementTree

import numpy as np


def robot(*joints, links=None):
    """Text of a URDF. joints : (name, type, parent, child, attributes {xyz, rpy, axis, limit, mimic})"""
    names = links or list(dict.fromkeys(link for joint in joints for link in joint[2:4]))
    lines = ['<?xml version="1.0"?>', '<robot name="test">', *(f'  <link name="{name}"/>' for name in names)]
    for name, kind, parent, child, given in joints:
        lines += [
            f'  <joint name="{name}" type="{kind}">',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f'    <origin xyz="{_words(given.get("xyz", (0, 0, 0)))}" rpy="{_words(given.get("rpy", (0, 0, 0)))}"/>',
        ]
        if "axis" in given:
            lines.append(f'    <axis xyz="{_words(given["axis"])}"/>')
        if "limit" in given:
            low, high = given["limit"]
            lines.append(f'    <limit lower="{low}" upper="{high}" effort="1" velocity="1"/>')
        if "mimic" in given:
            leader, *numbers = given["mimic"] if isinstance(given["mimic"], tuple) else (given["mimic"],)
            by = "".join(f' {key}="{value!r}"' for key, value in zip(("multiplier", "offset"), numbers))
            lines.append(f'    <mimic joint="{leader}"{by}/>')
        lines.append("  </joint>")
    return "\n".join([*lines, "</robot>", ""])


def _words(values):
    return " ".join(repr(float(value)) for value in values)


def product(text, values, tip):
    """(4, 4) pose of a link in the root, from the text of a URDF and {joint: value}, by the specification alone."""
    joints = ElementTree.fromstring(text).findall("joint")
    above, named = ({key(joint): joint for joint in joints} for key in (_child, lambda joint: joint.get("name")))

    def value_of(name):
        mimic = named[name].find("mimic")
        if mimic is None:
            return values.get(name, 0.0)
        return float(mimic.get("multiplier", 1)) * value_of(mimic.get("joint")) + float(mimic.get("offset", 0))

    M = np.eye(4)
    while tip in above:
        joint = above[tip]
        M = _origin(joint) @ _motion(joint, value_of(joint.get("name"))) @ M
        tip = joint.find("parent").get("link")
    return M


def _child(joint):
    return joint.find("child").get("link")


def _origin(joint):
    origin, M = joint.find("origin"), np.eye(4)
    if origin is None:
        return M
    roll, pitch, yaw = map(float, origin.get("rpy", "0 0 0").split())
    M[:3, :3] = _turn([0, 0, 1], yaw) @ _turn([0, 1, 0], pitch) @ _turn([1, 0, 0], roll)
    M[:3, 3] = [float(word) for word in origin.get("xyz", "0 0 0").split()]
    return M


def _motion(joint, value):
    M = np.eye(4)
    if joint.get("type") == "fixed":
        return M
    stated = joint.find("axis")
    axis = np.array([float(word) for word in ("1 0 0" if stated is None else stated.get("xyz")).split()])
    axis /= np.linalg.norm(axis)
    if joint.get("type") == "prismatic":
        M[:3, 3] = value * axis
    else:
        M[:3, :3] = _turn(axis, value)
    return M


def _turn(axis, angle):
    """Rodrigues' formula."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], float)
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K
