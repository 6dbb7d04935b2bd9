"""fit=auto: how much work a capture is worth, and short fits that tell what suits it best."""
