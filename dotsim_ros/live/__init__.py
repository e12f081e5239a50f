"""The live page: a sensor, a running node or a bag in the browser, and an indenter to drag."""
