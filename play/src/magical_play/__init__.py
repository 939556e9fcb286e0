"""Playing, recording and viewing in the browser.

- `security`: the token, accepted hosts and origins, rate limits and deadlines.
- `messages`: typed records of what the page may send.
- `frames`: frames as lossless WebP files.
- `episode`: an episode that is being played, and its trajectory.
- `policies`: the scripted expert and the runs, by number; loaded when first used.
- `driver`: a policy in one episode: watched, rolled out, or asked for its action probabilities.
- `session`: one player's environment, clock and episode.
- `players`: all sessions of a server, up to a limit.
- `connection`: a session over one WebSocket.
- `library/`: datasets and rollouts, and what the page shows of them.
- `server`: the application and its routes.
- `page/`: the page's static files.
"""
