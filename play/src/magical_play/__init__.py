"""The browser: play, record demonstrations, watch episodes and policies, take over from them."""
