"""From structure to C: expression graph, printer, templates."""
