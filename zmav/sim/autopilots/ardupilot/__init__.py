"""What every ArduPilot has, whatever it steers."""
