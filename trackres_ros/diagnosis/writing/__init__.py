"""What is believed in, vehicle file, surroundings and lines of the topics file out."""
