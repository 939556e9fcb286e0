"""Playing, recording and viewing in the browser.

- `security`: the token, which hosts and origins are accepted, rates and deadlines.
- `messages`: what the page may send, as records.
- `frames`: frames as lossless WebP files.
- `episode`: an episode that is played, and its trajectory.
- `policies`: the scripted expert and the runs, by number; loaded when they are first used.
- `driver`: a policy in one episode: watched, rolled out, or asked for its action probabilities.
- `session`: one player's environment, clock and episode.
- `players`: all sessions of a server, at most so many.
- `connection`: a session over one WebSocket.
- `library/`: datasets and rollouts, and what the page shows of them.
- `server`: the application and its routes.
- `page/`: the page, as it is sent.
"""
