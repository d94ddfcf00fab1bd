"""One table over controllers, operators and links: many scenarios made from one, run and measured.

What is compared is data: a variants file (TOML) says which components of a scenario are the arms
and their controllers, and which controllers, operators and links to put in their place. This
package knows no controller and no robot.
"""
