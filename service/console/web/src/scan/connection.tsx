import { api, longCall, resultOf } from "../net/api";
import { cell } from "../state/cell";
import { t } from "../texts/translate";
import { Act, Failed, useAction } from "../ui/action";

/** Connects arm and camera without a scan, or releases the arm for other programs. Nothing moves. */
export function Connection() {
  const action = useAction();
  const state = cell.value?.state;
  if (state !== "not_ready" && state !== "ready") return null;
  const ready = state === "ready";
  return (
    <>
      <Act
        action={action}
        doing={ready ? t("scan.connection.releasing") : t("scan.connection.connecting")}
        work={async () => {
          cell.value = await resultOf(api.POST(ready ? "/api/cell/release" : "/api/cell/connect", longCall));
        }}
      >
        {ready ? t("scan.connection.release") : t("scan.connection.connect")}
      </Act>
      <Failed failure={action.failure} />
    </>
  );
}
