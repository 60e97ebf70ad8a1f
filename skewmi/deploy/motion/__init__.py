"""From commanded hand positions to chunks of joint motion that end at rest."""
