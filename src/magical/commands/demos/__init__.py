"""Demonstrations: import the human ones, generate, inspect, replay, render and export.

A dataset DIR is a folder with one file for each demonstration, and a manifest.
"""

import argparse

from magical.commands.demos import exporting, generating, importing, inspecting

HELP = "demonstrations: import, generate, replay, export"


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the sub-commands and their arguments."""
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in (importing, generating, inspecting, exporting):
        module.add_commands(subparsers)


def run(args: argparse.Namespace) -> int:
    """Run the chosen sub-command."""
    return int(args.run_demos(args))
