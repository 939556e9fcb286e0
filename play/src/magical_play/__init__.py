"""The browser: play, record demonstrations, watch episodes and policies, take over from them.

- `command`: `magical play`.
- `server`: the application, its WebSocket and its clock; one person at a time.
- `security`: the token, accepted hosts and origins.
- `messages`: typed records of what the page may send.
- `session`: what is played or watched, its phases, who acts, recording.
- `episodes`: an episode that is being played, and a recorded one; frames as WebP files.
- `policies`: the policies that can be watched, and one that acts in an episode.
- `page/`: the page's static files.
"""
