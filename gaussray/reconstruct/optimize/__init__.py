"""What a step changes: loss, gradients, learning rates, density control, checkpoints."""
