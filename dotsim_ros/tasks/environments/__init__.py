"""The sensor in worlds of rigid bodies, and tasks for learning in them."""
