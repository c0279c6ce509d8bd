"""Reads VMC packets with python-osc: a packet a line in hex on standard input, its messages a line as JSON on standard output."""
import json
import sys

from pythonosc.osc_bundle import OscBundle

for line in sys.stdin:
    bundle = OscBundle(bytes.fromhex(line))
    print(json.dumps([[message.address, *message.params] for message in bundle]))
