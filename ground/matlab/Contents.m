% zmav: fly and watch a fleet of vehicles from MATLAB and GNU Octave, through the gateway 'zmav http'.
%
% Positions are metres north, east, down about the fleet's origin, or degrees WGS84 where a name ends in _deg; angles
% are radians; times are UTC seconds. Errors are called zmav:KIND and carry the vehicle's own words.
%
% Begin and end
%   zmav_open             - Begin to use a fleet through its HTTP gateway
%   zmav_close            - Give back what was taken: leases, streams
%   zmav_vehicles         - Who is there
%
% Look
%   zmav_get              - State of a vehicle, or whatever else the key space holds
%   zmav_last             - Fields of the last MAVLink message of a kind
%   zmav_wait             - Wait until something holds for a vehicle's state
%   zmav_stream           - Have a vehicle's messages sent here by UDP
%   zmav_read             - Messages that have come on a stream
%   zmav_stop             - End a stream
%   zmav_decode           - MAVLink frames out of bytes
%   zmav_fields           - Fields of such a frame
%
% Fly
%   zmav_arm              - Wait until it is ready, and arm
%   zmav_disarm           - Disarm on the ground
%   zmav_takeoff          - Climb to a height
%   zmav_goto             - Fly to a point, and wait for the arrival
%   zmav_mode             - Enter a flight mode
%   zmav_hold             - Stop where it is
%   zmav_land             - Land where it is
%   zmav_rtl              - Return to launch
%   zmav_setpoint         - One point of a command stream, 5 to 10 Hz
%   zmav_release          - End that stream
%   zmav_do               - Any order
%   zmav_send             - One MAVLink message
%
% Configure
%   zmav_param_get        - A parameter, or all
%   zmav_param_set        - Set a parameter and read it back
%   zmav_mission_item     - One item of a mission
%   zmav_mission_upload   - Replace the mission, fence or rally points
%   zmav_mission_get      - Mission, fence or rally points
%   zmav_mission_start    - Fly the mission
%   zmav_mission_clear    - Clear it
%
% Controllers and other agents
%   zmav_agent_do         - An order to an agent: engage, release, goto, inject ...
%   zmav_agent_param_get  - A parameter of an agent, or all with their bounds
%   zmav_agent_param_set  - Change one while it runs
%
% Examples
%   zmav_square           - Take off, fly a square, land
%   zmav_follow           - An outer loop of position commands
%
% Simulink
%   zmav_simulink_library - Make the block library
%   ZmavTelemetry         - System object: fields of a message
%   ZmavState             - System object: state of a vehicle
%   ZmavSetpoint          - System object: a command stream
%   zmav_sfun             - The same as a Level-2 S-function
%   zmav_block            - What they do, in plain functions
%   zmav_block_names      - Names of a block's values
%
% Beneath
%   zmav_http             - Ask the gateway
%
% See also the guide docs/matlab.md.
