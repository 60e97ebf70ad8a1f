"""OpenPressClose: lift the lid of a box by its handle, press the button inside, shut the lid."""
