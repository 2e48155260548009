"""What measures and builds beside the package; nothing here ships."""
