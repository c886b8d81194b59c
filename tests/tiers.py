"""Which tests run always, and which only with `--everything`, or with `--others`, which leaves out the quick ones.

A test is quick unless it has one of the marks below, by a decorator or by the table. The quick ones cover every room: a law
of each kind in both forms and precisions, files, a map, a picture, a command, the simulator, the reference. Together they
may take two minutes on two cores when nothing is compiled yet; a new test that compiles a program of its own is slow.
"""

MARKS = ("slow", "sim", "evaluation")
"""What is left out unless it is asked for. All are registered in pyproject.toml."""

QUICK: dict[str, tuple[str, ...]] = {
    "test_actuated_cone.py": (
        "test_faces_of_a_sum",
        "test_a_wrench_is_within_the_faces_if_and_only_if_forces_and_torques_make_it[arm]",
        "test_a_joint_that_gravity_turns",
        "test_what_cannot_be_is_named",
        "test_a_limb_on_two_links",
        "test_too_many_faces",
        "test_on_the_host_only",
    ),
    "test_advance.py": (
        "test_what_cannot_be_is_named",
        "test_the_oracle_agrees_with_the_pendulum",
    ),
    "test_angular_momentum.py": ("test_wrong_shapes_are_named",),
    "test_binding_joints.py": ("test_what_cannot_be_used_is_named",),
    "test_batch.py": (
        "test_what_is_left_is_sorted_by_kind_and_slope[1]",
        "test_fields_have_their_types",
        "test_importing_costs_no_extra",
    ),
    "test_capture_region.py": ("",),
    "test_capture_point.py": (
        "test_capture_point_by_hand",
        "test_at_rest_the_capture_point_is_the_com",
        "test_without_a_positive_height_there_is_no_capture_point",
        "test_axes_across_gravity",
        "test_wrong_shapes_are_type_errors",
    ),
    "test_cli.py": (
        "test_version",
        "test_help",
        "test_the_contact_file_in_the_help_is_valid",
        "test_no_command_is_wrong_usage",
        "test_closing_table",
        "test_quantiles_of_the_margin",
        "test_arrays_that_are_not_carried_through_are_named",
        "test_scores_are_those_of_the_library[float32",
        "test_zero_rows",
        "test_sides_reach_the_cone_and_the_metadata",
        "test_a_cone_that_cannot_be_built_is_bad_input",
        "test_force_replaces_the_output",
        "test_interrupt_in_process",
    ),
    "test_cli_baselines.py": (
        "test_heights_that_are_refused",
        "test_a_column_of_that_name_is_refused",
        "test_help_names_the_columns",
    ),
    "test_cli_cache.py": (
        "test_a_folder",
        "test_python_keeps",
        "test_a_map_is_computed_with_the_cache",
        "test_nothing_is_kept",
        "test_settings_are_put_back_after_an_error",
        "test_a_directory_that_cannot_be_written",
        "test_help_names_the_option",
    ),
    "test_cli_contacts.py": (
        "test_columns_of_contacts_are_carried_through[parquet-parquet",
        "test_columns_of_contacts_that_are_refused",
        "test_choices_that_there_are_not",
        "test_one_row_that_cannot_be_used",
        "test_a_row_of_null",
        "test_help_explains_contacts_of_rows",
    ),
    "test_cli_map.py": (
        "test_help_of_map_is_good_reading",
        "test_the_list_of_commands_has_one_line_for_it",
        "test_options_reach_the_map",
        "test_a_speed_brings_the_verdict",
        "test_velocities_by_components_need_no_heading",
        "test_defaults_lie_around_the_contacts",
        "test_places_that_are_hardly_plausible_are_told",
        "test_options_that_cannot_be_used",
        "test_files_that_cannot_be_used",
        "test_force_overwrites",
        "test_shards_make_the_whole[order0",
        "test_places_that_cannot_be_used",
    ),
    "test_cli_momentum_box.py": ("test_boxes_that_cannot_be_used",),
    "test_cli_next.py": ("test_what_cannot_be_is_named", "test_one_delay_or_one_model", "test_help"),
    "test_contact_axes.py": (
        "test_a_level_set_with_its_own_friction_is_untouched",
        "test_defaults_lie_around_all_sets",
        "test_contacts_that_cannot_be_mapped",
    ),
    "test_contact_gradients.py": (),
    "test_contact_rows.py": (
        "test_every_spelling_reads_the_same",
        "test_one_friction_a_row",
        "test_whole_numbers_and_single_precision",
        "test_no_contact_in_any_row",
        "test_contacts_are_padded_in_each_batch_to_a_multiple_of_four",
        "test_choices_by_number_and_by_name",
        "test_a_choice_that_there_is_not",
        "test_no_choice",
        "test_a_row_is_bad_if_and_only_if_it_makes_no_contact_set",
    ),
    "test_devices.py": (),
    "test_edges.py": ("test_slack_changes_verdicts_within_its_distance_only[float64-faces",),
    "test_evaluation_roc.py": ("",),
    "test_export.py": ("test_what_cannot_be_exported",),
    "test_gradients.py": (),
    "test_gradients_flat_floors.py": (),
    "test_inputs.py": (
        "test_gravity_as_a_number",
        "test_contacts_in_place_of_a_cone",
    ),
    "test_kernel_checks.py": (),
    "test_laws.py": (
        "test_the_states_are_worth_testing",
        "test_translation",
        "test_yaw",
        "test_order_of_contacts",
        "test_scale_of_length_and_time",
        "test_another_contact_never_hurts",
        "test_more_friction_never_hurts",
        "test_margin",
    ),
    "test_maps_of_effort.py": ("test_without_a_posture",),
    "test_maps.py": (
        "test_a_file_is_the_map_and_opens_without_us",
        "test_what_a_map_says_of_itself",
        "test_values_ranges_and_lists",
        "test_a_full_circle_does_not_repeat_its_end",
        "test_the_direction_of_heading_and_pitch",
        "test_a_state_that_is_not_there",
        "test_axes_that_cannot_be_used",
        "test_options_that_cannot_be_used",
        "test_contacts_that_cannot_be_used",
        "test_outputs_that_cannot_be_written",
        "test_a_map_that_does_not_fit",
        "test_importing_the_library_needs_no_xarray",
        "test_a_missing_extra_says_what_to_install",
        "test_settings_are_json",
    ),
    "test_limb_reach.py": ("",),
    "test_momentum_box.py": (
        "test_no_box_is_today_to_the_bit",
        "test_the_polyhedron_is_the_sum_of_cone_and_box",
        "test_the_normals_of_the_cone_are_among_those_with_a_box",
        "test_boxes_that_are_none",
    ),
    "test_momentum_files.py": (
        "test_three_columns_in_a_csv",
        "test_what_is_refused",
        "test_a_mass_that_is_none",
        "test_help_names_them",
        "test_a_map_of_limits_needs_a_speed",
    ),
    "test_next_contact.py": ("test_what_cannot_be_is_named[change0", "test_what_cannot_be_is_named[change1"),
    "test_plain_qp.py": (),
    "test_plotting_limits.py": ("test_the_thick_line",),
    "test_plotting.py": (
        "test_a_window_clips_half_planes",
        "test_a_stance",
        "test_a_foot_is_four_corners_and_four_feet_are_points",
        "test_a_footprint_draws_them_from_above",
        "test_the_zero_level",
        "test_the_filled_contours_are_the_field_at_the_grid_points",
        "test_infinite_figures_and_those_that_are_none_are_told_apart",
        "test_a_field_without_any_number_is_drawn",
        "test_a_slice_has_names_units_and_tells_where_it_is",
        "test_codes_are",
        "test_what_a_map_does_not_hold_is_refused",
        "test_a_plane_needs_two_points_along_each_axis",
    ),
    "test_ray_form.py": ("test_too_few_sides",),
    "test_reference.py": (),
    "test_reference_oracles.py": (
        "test_event_integration_on_flat_ground",
        "test_event_integration_of_a_hanging_robot",
        "test_static_interval_of_flat_feet_is_their_hull",
        "test_speed_interval_on_flat_ground_and_its_error",
        "test_polygon_agrees_with_the_accelerations",
        "test_discretisation_covers_the_hanging_robot",
        "test_discretised_stop_obeys_the_polygon_between_its_knots",
        "test_verdict_by_discretisation",
    ),
    "test_robot_limits.py": ("test_wrong_shapes", "test_actuation_of_other"),
    "test_second_opinion.py": (),
    "test_sequences.py": (
        "test_what_cannot_be_is_named",
        "test_a_lifted_contact_is_not_lifted_again",
        "test_a_tree_that_is_too_large",
    ),
    "test_special_cases.py": (
        "test_inverted_pendulum_in_closed_form[faces-float64",
        "test_swings_below_a_support_in_closed_form[faces-float64",
        "test_a_state_that_is_not_finite_is_undecided[faces",
        "test_wrong_shapes_are_type_errors",
    ),
    "test_surface_files.py": ("",),
    "test_surfaces.py": ("",),
    "test_tsid_limits.py": ("",),
    "test_tsid_simulator.py": ("test_without_a_push_the_robot_has_stopped", "test_options_are_checked"),
    "test_tsid_summary.py": ("",),
    "test_tsid_touchdown.py": ("",),
    "test_tsid_wrench_cone.py": ("",),
    "test_velocity_area.py": ("test_the_mesh_of_a_ball_has_its_volume",),
}
"""Files with tests that are not quick: all but those whose names begin like these."""


def mark(items) -> None:
    """Gives every collected test the mark of its file."""
    for item in items:
        kind = kind_of(item.path.name)
        quick = QUICK.get(item.path.name, ("",) if kind == "slow" else ())
        if not item.name.startswith(quick):
            item.add_marker(kind)


def kind_of(file: str) -> str:
    """The mark of the tests of a file that are not quick; those of simulations and evaluation are not but for the table."""
    return "sim" if file.startswith("test_tsid") else "evaluation" if file.startswith("test_evaluation") else "slow"


def is_quick(item) -> bool:
    """Whether a test runs always."""
    return not any(item.get_closest_marker(name) for name in MARKS)


def part(option) -> str:
    """The part of the tests that pytest's options ask for: "all", "quick" or "others"."""
    return "all" if option.everything or option.markexpr else "others" if option.others else "quick"


def chosen(items, part: str) -> list:
    """The tests of a part, in their order."""
    return [item for item in items if part == "all" or is_quick(item) == (part == "quick")]
