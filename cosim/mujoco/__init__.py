"""A scene of MuJoCo (MJCF or URDF) as a Component; MuJoCo itself is loaded when a scene is."""
