"""The report: one RUN, or several side by side, as one HTML page that needs no network."""
