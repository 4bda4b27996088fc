"""Views: schedules, graphs, tables and recordings, for people to look at."""
