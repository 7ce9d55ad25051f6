"""What is remembered: tables, stores, window files, migrations."""
