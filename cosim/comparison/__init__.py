"""One table over controllers, operators and links: many scenarios made from one, run and measured.

What is compared is data: a variants file (TOML) names the components of a scenario that are the
arms and their controllers, and which controllers, operators and links to put in their place. This
package contains no code for particular controllers or robots.
"""
