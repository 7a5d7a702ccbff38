"""A graph whose nodes carry scans, and on which scans can be matched: what every method builds, mends or reads."""
