"""The cameras that film a scene, from options."""
