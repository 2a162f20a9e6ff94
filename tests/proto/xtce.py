"""Reads a body with the XTCE dictionary alone, to check the dictionary: xtce.py DICTIONARY CONTAINER FILE.hex."""

import json
import struct
import sys
import xml.etree.ElementTree as tree

NS = "{http://www.omg.org/spec/XTCE/20180204}"


def value_of(kind, data, at):
    """A parameter's value, and the byte after it."""
    name = kind.tag.removeprefix(NS)
    integer, real = kind.find(NS + "IntegerDataEncoding"), kind.find(NS + "FloatDataEncoding")
    if name == "StringParameterType":
        size = int(kind.find(f".//{NS}FixedValue").text) // 8
        return data[at:at + size].split(b"\0")[0].decode("ascii"), at + size
    encoding = integer if integer is not None else real
    size = int(encoding.get("sizeInBits")) // 8
    raw = data[at:at + size]
    if size > 1 and encoding.get("byteOrder") != "leastSignificantByteFirst":
        raw = raw[::-1]
    if real is not None:
        return struct.unpack({4: "<f", 8: "<d"}[size], raw)[0], at + size
    number = int.from_bytes(raw, "little", signed=integer.get("encoding") == "twosComplement")
    if name == "BooleanParameterType":
        return bool(number), at + size
    if name == "EnumeratedParameterType":
        return next(e.get("label") for e in kind.iter(NS + "Enumeration") if int(e.get("value")) == number), at + size
    return number, at + size


def main():
    dictionary, container, file = sys.argv[1:]
    root = tree.parse(dictionary).getroot()
    types = {kind.get("name"): kind for kind in root.find(f".//{NS}ParameterTypeSet")}
    parameters = {parameter.get("name"): parameter.get("parameterTypeRef") for parameter in root.find(f".//{NS}ParameterSet")}
    arguments = {kind.get("name") for kind in root.find(f".//{NS}ArgumentTypeSet")}
    missing = [a.get("argumentTypeRef") for a in root.iter(NS + "Argument") if a.get("argumentTypeRef") not in arguments]
    assert not missing, missing
    with open(file, encoding="ascii") as hexadecimal:
        body = bytes.fromhex("".join(hexadecimal.read().split()))[10:-4]
    values, at = {}, 0
    entries = root.find(f".//{NS}SequenceContainer[@name='{container}']/{NS}EntryList")
    for entry in entries:
        name = entry.get("parameterRef")
        values[name], at = value_of(types[parameters[name]], body, at)
    assert at == len(body), f"{at} of {len(body)} bytes"
    print(json.dumps(values))


main()
