import { useState } from "preact/hooks";
import { askNow } from "./state/follow";
import { signIn } from "./state/session";
import { Failed, useAction } from "./ui/action";
import { ManualLink, SECTIONS } from "./ui/manual";

/** Asks for the token, once: then it is in a cookie. */
export function Login() {
  const [token, setToken] = useState("");
  const action = useAction();
  return (
    <main id="main" class="login">
      <h1>Sign in</h1>
      <p>
        This cell needs a token, once in this browser. Whoever looks after the cell makes one by{" "}
        <code>pointchain token add</code>.
      </p>
      <form
        onSubmit={(event) => {
          event.preventDefault();
          void action.run(async () => {
            await signIn(token);
            askNow();
          });
        }}
      >
        <label>
          Token
          <input
            type="password"
            autocomplete="current-password"
            value={token}
            onInput={(event) => setToken(event.currentTarget.value)}
            required
          />
        </label>
        <button class="main" disabled={action.busy}>
          Sign in
        </button>
      </form>
      <Failed failure={action.failure && { ...action.failure, title: "Not signed in" }} />
      <p>
        <ManualLink page={SECTIONS["sign-in"]} name="Help with signing in">
          Help with signing in
        </ManualLink>
      </p>
    </main>
  );
}
