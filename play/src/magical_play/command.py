"""Play, record, and watch demonstrations and policies in the browser.

The first line of standard output is the page's address, with a token that it needs. On a server
without a display, forward the port (`ssh -L 8000:127.0.0.1:8000 server`) and open that address.
"""

import argparse
from pathlib import Path

from magical.commands._common import add_count, add_several, log

HELP = "play, record and watch demonstrations and policies in the browser"


def configure(parser: argparse.ArgumentParser) -> None:
    """Describe the command's arguments."""
    meaning = "environment to start with; the page offers others (default: %(default)s)"
    first = "magical/MoveToRegion-Demo-v0"
    parser.add_argument("--env", default=first, metavar="ID", help=meaning)
    meaning = "dataset to add kept episodes to"
    parser.add_argument("--record", type=Path, metavar="DIR", help=meaning)
    meaning = "datasets whose episodes can be watched; that of --record is always included"
    add_several(parser, "--datasets", meaning, "DIR", kind=Path, default=[])
    meaning = "run folders, or folders that contain runs, whose policies can be watched"
    add_several(parser, "--runs", meaning, "DIR", kind=Path, default=[])
    meaning = (
        "address to listen on; any but the default can be reached from outside, without "
        "encryption (default: %(default)s)"
    )
    parser.add_argument("--host", default="127.0.0.1", metavar="ADDRESS", help=meaning)
    add_count(parser, "--port", "port to listen on; 0: any free port", default=8000, least=0)
    meaning = "other host names by which browsers reach this server"
    add_several(parser, "--allow-host", meaning, "NAME", default=[])


def run(args: argparse.Namespace) -> int:
    """Listen, print the address, answer until interrupted."""
    from magical.demos import Dataset, DatasetWriter
    from magical.envs import parse_env_id
    from magical_play.policies import Policies
    from magical_play.security import LOOPBACK, make_guard, new_token, page_url
    from magical_play.server import PlayServer, listen, make_server
    from magical_play.session import Session

    env_id = parse_env_id(args.env).without_preset
    writer = DatasetWriter(args.record) if args.record else None
    datasets = [*args.datasets, *([args.record] if args.record else [])]
    folders = list({path.resolve(): path for path in datasets}.values())
    for folder in folders:
        Dataset.open(folder)  # raises for what is none
    session = Session(env_id, Policies(args.runs), folders, writer)
    token = new_token()
    server = PlayServer(make_guard(args.host, token, frozenset(args.allow_host)), session)
    with listen(args.host, args.port) as listening:
        print(page_url(args.host, listening.getsockname()[1], token), flush=True)
        log(f"recording into {args.record}" if args.record else "not recording (see --record)")
        if args.host not in LOOPBACK:
            log(
                "everything, the token included, is sent in the clear: whoever sees the traffic "
                "can use the server; instead, listen on loopback behind an HTTPS proxy, and name "
                "its host with --allow-host (docs/play.md), or forward the port with ssh -L"
            )
        make_server(server.app).run(sockets=[listening])
    return 0
