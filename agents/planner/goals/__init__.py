"""From what a person wants to what each vehicle shall do: pure functions, no network and no clock."""
