"""Play, record and look in the browser.

The first line of standard output is the page's address, with a token that it needs. On a server
without a display, forward the port (`ssh -L 8000:127.0.0.1:8000 server`) and open that address.
"""

import argparse
from pathlib import Path

from magical.commands._common import log, non_negative_int, positive_int

HELP = "play, record and look at demonstrations and policies in the browser"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    parser.add_argument(
        "--env",
        default="magical/MoveToRegion-Demo-v0",
        metavar="ID",
        help="where players start; they can choose others (default: %(default)s)",
    )
    parser.add_argument(
        "--record", type=Path, metavar="DIR", help="the dataset that kept episodes are added to"
    )
    parser.add_argument(
        "--datasets",
        type=Path,
        nargs="+",
        action="extend",
        default=[],
        metavar="DIR",
        help="datasets to look at; that of --record is always among them",
    )
    parser.add_argument(
        "--runs",
        type=Path,
        nargs="+",
        action="extend",
        default=[],
        metavar="DIR",
        help="run folders, or folders with runs in them, whose policies can be watched",
    )
    _configure_server(parser)


def _configure_server(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="to listen on; anything but the default is reachable from outside, without "
        "encryption (default: %(default)s)",
    )
    parser.add_argument(
        "--port",
        type=non_negative_int,
        default=8000,
        metavar="N",
        help="default: 8000; 0: a free one",
    )
    parser.add_argument(
        "--allow-host",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help="other names under which browsers address this server",
    )
    parser.add_argument(
        "--max-players",
        type=positive_int,
        default=16,
        metavar="N",
        help="environments at the same time (default: 16)",
    )


def run(args: argparse.Namespace) -> int:
    """Listen, print the address, answer until interrupted."""
    from magical.envs import parse_env_id
    from magical.web.security import is_loopback, make_guard, new_token, page_url
    from magical.web.server import PlayServer, PlaySettings, listen, make_server

    env_id = parse_env_id(args.env).without_preset
    token = new_token()
    settings = PlaySettings(env_id, args.record, args.max_players, args.datasets, args.runs)
    server = PlayServer(settings, make_guard(args.host, token, frozenset(args.allow_host)))
    with listen(args.host, args.port) as listening:
        print(page_url(args.host, listening.getsockname()[1], token), flush=True)
        log(f"recording into {args.record}" if args.record else "not recording (see --record)")
        if not is_loopback(args.host):
            log(
                "the token and everything else travel in clear: whoever sees the traffic can use "
                "the server; put a proxy with HTTPS in front of a server on loopback, and name its "
                "host with --allow-host (docs/play.md), or forward the port with ssh -L"
            )
        make_server(server.app).run(sockets=[listening])
    return 0
