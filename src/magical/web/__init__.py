"""Playing, recording and looking in the browser.

- `security`: the token, and which hosts and origins are accepted.
- `messages`: what the page may send over the socket, checked.
- `frames`: frames as PNG files.
- `episode`: an episode that is played, and its trajectory.
- `session`: one player's environment, clock and episode.
- `driver`: a policy that is watched, in one episode.
- `players`: all sessions of a server, at most so many.
- `recorder`: storing kept episodes beside the event loop.
- `connection`: a session over one WebSocket.
- `library/`: datasets, runs and rollouts, and what the page shows of them.
- `server`: the application and its routes.
- `page/`: the page, as it is sent.
"""
