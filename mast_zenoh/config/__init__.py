"""What users write becomes objects: files are found and loaded, classes are looked up by name, settings are applied."""
