"""Texts of XML files, and the manifest that every layered standard of FMI has."""

from xml.etree import ElementTree as ET

MANIFEST = "http://fmi-standard.org/fmi-ls-manifest"


def xml_text(root: ET.Element) -> str:
    """The file of a tree."""
    ET.indent(root)
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    return head + ET.tostring(root, encoding="unicode") + "\n"


def layered_manifest(name: str, version: str, about: str) -> ET.Element:
    """The root of extra/NAME/fmi-ls-manifest.xml."""
    ET.register_namespace("fmi-ls", MANIFEST)
    own = {"name": name, "version": version, "description": about}
    return ET.Element(
        "fmiLayeredStandardManifest",
        {f"{{{MANIFEST}}}fmi-ls-{k}": text for k, text in own.items()},
    )
