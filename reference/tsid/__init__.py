"""The whole-body truth: a robot under an inverse-dynamics controller, pushed and simulated (V-A to V-E, Appendix D)."""
