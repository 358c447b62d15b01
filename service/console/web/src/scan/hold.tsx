import { api, slowly, told } from "../net/api";
import { cell } from "../state/cell";
import { Act, Failed, useAction } from "../ui/action";

/** Takes the arm and the camera without a scan, or lets the arm go for other programs. Nothing moves. */
export function Hold() {
  const action = useAction();
  const state = cell.value?.state;
  if (state !== "not_ready" && state !== "ready") return null;
  const [call, words, doing] =
    state === "ready"
      ? (["/api/cell/release", "Let the arm go for other programs: nothing moves", "Letting go ..."] as const)
      : (["/api/cell/connect", "Connect arm and camera: nothing moves", "Connecting ..."] as const);
  return (
    <>
      <Act
        action={action}
        doing={doing}
        work={async () => {
          cell.value = await told(api.POST(call, slowly));
        }}
      >
        {words}
      </Act>
      <Failed failure={action.failure} />
    </>
  );
}
