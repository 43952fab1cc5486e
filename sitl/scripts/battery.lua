-- Battery of an outside physics: its voltage (V) and current (A) arrive as the distances of range finders 1 and 2.
-- Needs SCR_ENABLE 1, BATT_MONITOR 29, RNGFND1_TYPE 100 and RNGFND2_TYPE 100 (see json.parm).

local PERIOD_MS = 50

function update()
    local volts, amps = rangefinder:get_backend(0), rangefinder:get_backend(1)
    if volts and amps and volts:distance() > 1 then
        local state = BattMonitorScript_State()
        state:healthy(true)
        state:voltage(volts:distance())
        state:current_amps(amps:distance())
        battery:handle_scripting(0, state)
    end
    return update, PERIOD_MS
end

return update, PERIOD_MS
