"""The native wire: msgpack over WebSocket, decoded defensively, no pickle."""
