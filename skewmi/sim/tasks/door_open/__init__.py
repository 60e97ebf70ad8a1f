"""DoorOpen: lift a flap by its handle to a given angle."""
