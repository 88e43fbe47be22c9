"""``zmav http``: serve the fleet over HTTP and WebSocket."""
